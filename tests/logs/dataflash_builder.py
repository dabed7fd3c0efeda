"""DataFlash logs made in tests, record by record, as the firmware writes them."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

CODES = {
    **{"b": "b", "B": "B", "h": "h", "H": "H", "i": "i", "I": "I", "f": "f", "d": "d", "q": "q", "Q": "Q"},
    **{"n": "4s", "N": "16s", "Z": "64s", "c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "M": "B"},
}
FMT = (0x80, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
MAG = (10, "MAG", "QBhhhhhh", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ")
IMU = (11, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
ATT = (12, "ATT", "Qccccfff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,E")
PARM = (13, "PARM", "QNf", "TimeUS,Name,Value")
MSG = (14, "MSG", "QZ", "TimeUS,Message")
GPS = (15, "GPS", "QBIHBcLLefff", "TimeUS,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ")
BAT = (16, "BAT", "QBff", "TimeUS,Inst,Volt,Curr")
FMTU = (20, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")
UNIT = (21, "UNIT", "QbZ", "TimeUS,Id,Label")
MULT = (22, "MULT", "Qbd", "TimeUS,Id,Mult")


class Log:
    """Write one log."""

    def __init__(self, *formats: tuple[int, str, str, str]) -> None:
        self.parts: list[bytes] = []
        self.formats: dict[str, tuple[int, str]] = {"FMT": (FMT[0], FMT[2])}
        for one in (FMT, *formats):
            self.format(*one)

    def format(self, number: int, name: str, characters: str, columns: str) -> None:
        length = 3 + struct.calcsize("<" + "".join(CODES[c] for c in characters))
        self.formats[name] = (number, characters)
        self.add("FMT", number, length, name, characters, columns)

    def add(self, name: str, *values: Any) -> Log:
        number, characters = self.formats[name]
        packed = [value.encode("latin1") if isinstance(value, str) else value for value in values]
        body = struct.pack("<" + "".join(CODES[c] for c in characters), *packed)
        self.parts.append(bytes((0xA3, 0x95, number)) + body)
        return self

    def mags(self, count: int = 20, start_us: int = 1_000_000, x: int = 200, offset: int = 5) -> Log:
        for n in range(count):
            self.add("MAG", start_us + n * 100_000, 0, x, n, -500, offset, 13, -18)
        return self

    @property
    def content(self) -> bytes:
        return b"".join(self.parts)

    def write(self, path: Path) -> Path:
        path.write_bytes(self.content)
        return path
