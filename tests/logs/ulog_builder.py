"""ULog files made in tests, message by message, as PX4 writes them."""

from __future__ import annotations

import struct
from pathlib import Path

_CODES = {"uint64_t": "Q", "float": "f", "int32_t": "i", "uint32_t": "I", "uint8_t": "B", "double": "d"}


class ULogFile:
    """Write one log: formats and parameters first, then data."""

    def __init__(self, start_us: int = 1_000_000) -> None:
        self.parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", start_us)]
        self._message(b"B", bytes(40))
        self._formats: dict[str, list[tuple[str, str]]] = {}
        self._ids: dict[tuple[str, int], int] = {}

    def _message(self, kind: bytes, body: bytes) -> None:
        self.parts.append(struct.pack("<H", len(body)) + kind + body)

    def topic(self, name: str, *fields: str) -> ULogFile:
        """Define a topic: each field as 'float x' or 'float[3] x'; its time stamp comes by itself."""
        pairs = [("uint64_t", "timestamp")]
        for field in fields:
            kind, label = field.split()
            base, _, count = kind.partition("[")
            pairs += [(base, label)] * int(count.rstrip("]") or 1) if count else [(base, label)]
        text = ";".join(["uint64_t timestamp", *fields]) + ";"
        self._message(b"F", f"{name}:{text}".encode())
        self._formats[name] = pairs
        return self

    def parameter(self, name: str, value: float) -> ULogFile:
        key = f"{'int32_t' if isinstance(value, int) else 'float'} {name}".encode()
        packed = struct.pack("<i" if isinstance(value, int) else "<f", value)
        self._message(b"P", bytes((len(key),)) + key + packed)
        return self

    def add(self, name: str, time_us: int, *values: float, instance: int = 0) -> ULogFile:
        key = (name, instance)
        if key not in self._ids:
            self._ids[key] = len(self._ids)
            self._message(b"A", struct.pack("<BH", instance, self._ids[key]) + name.encode())
        codes = "".join(_CODES[kind] for kind, _ in self._formats[name])
        self._message(b"D", struct.pack("<H" + codes, self._ids[key], time_us, *values))
        return self

    def write(self, path: Path) -> Path:
        path.write_bytes(b"".join(self.parts))
        return path
