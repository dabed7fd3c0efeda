"""A serial port or USB cable: pyserial (the extra `serial`) sets it up, bytes go straight to its file."""

from __future__ import annotations

import os
import termios
from typing import Any

from mavcompass.errors import UsageError
from mavcompass.installation.parts import require
from mavcompass.vehicle.transport.stream import StreamTransport
from mavcompass.vehicle.transport.transport import Reconnect


def open_serial(device: str, baud: int, reconnect: Reconnect) -> StreamTransport:
    """Open a serial port. Raises NoVehicle when it is not there, UsageError without pyserial."""
    require("A serial port")
    import serial

    def opened() -> Any:
        try:
            port = serial.Serial(device, baud, timeout=0, exclusive=True)
        except serial.SerialException as error:
            if error.errno is None:
                raise
            raise OSError(error.errno, os.strerror(error.errno)) from error  # without pyserial's repetitions
        except ValueError as error:
            raise UsageError(f"{device} cannot run at {baud} baud.", "Choose another rate.") from error
        # pyserial lets a read return nothing for "nothing yet"; this way it only means "unplugged".
        settings = termios.tcgetattr(port.fileno())
        settings[6][termios.VMIN] = 1
        termios.tcsetattr(port.fileno(), termios.TCSANOW, settings)
        return port

    return StreamTransport(
        device,
        opened,
        reconnect,
        "Check the cable and the device's name (ls /dev/serial/by-id), that no other program has it open,"
        " and that you may use it (group dialout).",
    )
