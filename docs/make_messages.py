"""Write the table of ``docs/messages.md``: how every field of a message of ROS and MoveIt is read.

python docs/make_messages.py
"""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

from microbot_ocp._base.messages import MESSAGES

PAGE = Path(__file__).resolve().parent / "messages.md"
MARKS = "<!-- made by docs/make_messages.py -->\n", "<!-- end of what is made -->\n"


def table() -> str:
    rows = ["| message | field | | how, or why |", "|---|---|---|---|"]
    for kind, fields in MESSAGES.items():
        for field, names in groupby(fields, fields.__getitem__):
            listed = ", ".join(f"`{name}`" for name in names)
            how = "; ".join(filter(None, [field.why, f"see {field.of}" if field.of else ""]))
            rows.append(f"| {kind} | {listed} | {field.verdict} | {how} |")
            kind = ""
    return "\n".join(rows) + "\n"


def page() -> str:
    before, _, rest = PAGE.read_text("utf-8").partition(MARKS[0])
    return f"{before}{MARKS[0]}\n{table()}\n{MARKS[1]}{rest.partition(MARKS[1])[2]}"


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
