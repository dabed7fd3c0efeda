"""The formats of recordings: each a room (or a file) of its own that says how to recognise and read it.

It offers its `NAME` for people, the `SUFFIXES` of its files, `recognises(head)` by the first bytes of a file,
and `read(path, head)`, which gives the Tracks in it by MAVLink system id (1 where the format knows none).
"""
