"""Write the lists of ``docs/messages.md``: how every field of a message of ROS and MoveIt is read.

python docs/make_messages.py
"""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

from microbot_ocp._base.messages import MESSAGES, Field

PAGE = Path(__file__).resolve().parent / "messages.md"
MARKS = "<!-- made by docs/make_messages.py -->\n", "<!-- end of what is made -->\n"


def lists() -> str:
    """Return the fields of every message by verdict; messages kept whole share the last line."""
    parts, whole = [], []
    for kind, fields in MESSAGES.items():
        if all(field.verdict == "kept" and not remark(field) for field in fields.values()):
            whole.append(kind)
            continue
        lines = [f"**{kind}**\n"]
        for verdict in ("kept", "refused", "harmless"):
            ours = {n: remark(field) for n, field in fields.items() if field.verdict == verdict}
            if ours:
                groups = groupby(ours, ours.__getitem__)
                listed = ", ".join(group(list(names), why) for why, names in groups)
                lines.append(f"- {verdict}: {listed}")
        parts.append("\n".join(lines))
    return "\n\n".join([*parts, f"Every field is kept: {', '.join(whole)}."]) + "\n"


def remark(field: Field) -> str:
    """Return the reason, and the nested message if some of its fields are refused."""
    refused = any(inner.verdict == "refused" for inner in MESSAGES.get(field.of, {}).values())
    nested = f"see {field.of}" if refused or " " in field.of else ""
    return "; ".join(filter(None, [field.why, nested]))


def group(names: list[str], why: str) -> str:
    return ", ".join(f"`{name}`" for name in names) + (f" ({why})" if why else "")


def page() -> str:
    before, _, rest = PAGE.read_text("utf-8").partition(MARKS[0])
    return f"{before}{MARKS[0]}\n{lists()}\n{MARKS[1]}{rest.partition(MARKS[1])[2]}"


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
