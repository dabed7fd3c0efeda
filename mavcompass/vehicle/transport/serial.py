"""A serial port or USB cable, through pyserial (the extra `serial`)."""

from __future__ import annotations

import os
import termios
from typing import Any

from mavcompass.errors import UsageError
from mavcompass.installation.parts import require
from mavcompass.vehicle.transport.stream import StreamTransport
from mavcompass.vehicle.transport.transport import READ_BYTES, Reconnect


class SerialStream:
    """Be one open serial port; pyserial sets it up, reading and writing go straight to the file."""

    def __init__(self, port: Any) -> None:
        self._port = port
        os.set_blocking(port.fileno(), False)
        # pyserial lets a read return nothing for "nothing yet"; this way it only means "unplugged".
        settings = termios.tcgetattr(port.fileno())
        settings[6][termios.VMIN] = 1
        termios.tcsetattr(port.fileno(), termios.TCSANOW, settings)

    def fileno(self) -> int:
        """Return the file's number."""
        return int(self._port.fileno())

    def read(self) -> bytes:
        """Return what has come. Raises EOFError when the device is gone."""
        try:
            data = os.read(self._port.fileno(), READ_BYTES)
        except BlockingIOError:
            return b""
        if not data:
            raise EOFError
        return data

    def write(self, data: bytes) -> int:
        """Send what is taken at once."""
        return os.write(self._port.fileno(), data)

    def close(self) -> None:
        """Close the port."""
        self._port.close()


def open_serial(device: str, baud: int, reconnect: Reconnect) -> StreamTransport:
    """Open a serial port. Raises NoVehicle when it is not there, UsageError without pyserial."""
    require("A serial port")
    import serial

    def open_stream() -> SerialStream:
        try:
            return SerialStream(serial.Serial(device, baud, timeout=0, exclusive=True))
        except serial.SerialException as error:
            if error.errno is None:
                raise
            raise OSError(error.errno, os.strerror(error.errno)) from error  # without pyserial's repetitions
        except ValueError as error:
            raise UsageError(f"{device} cannot run at {baud} baud.", "Choose another rate.") from error

    return StreamTransport(
        device,
        open_stream,
        reconnect,
        "Check the cable and the device's name (ls /dev/serial/by-id), that no other program has it open,"
        " and that you may use it (group dialout).",
    )
