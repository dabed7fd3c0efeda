"""Bytes to and from peers over UDP, TCP and serial ports, and the addresses that name them."""
