"""Write the table of MAVLink messages anew, from the installed pymavlink."""

from __future__ import annotations

from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega

TABLE = Path(__file__).parents[1] / "mavcompass" / "mavlink" / "messages.txt"


def lines() -> list[str]:
    """List what pymavlink says of each message: number, name, extra byte, layout, fields on the wire."""
    return [
        " ".join([str(number), m.msgname, str(m.crc_extra), m.unpacker.format, *m.ordered_fieldnames])
        for number, m in sorted(ardupilotmega.mavlink_map.items())
    ]


if __name__ == "__main__":
    TABLE.write_text("\n".join(lines()) + "\n", "ascii")
