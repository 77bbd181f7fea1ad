"""Which other machines a program asks, seen by strace."""

import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

CALLS = "trace=connect,sendto,sendmsg,sendmmsg"
NEAR = ("127.", "0.0.0.0", "::1", "::ffff:127.")
ADDRESS = re.compile(
    r"htons\((?P<port>\d+)\).*?"
    r'(?:inet_addr\("(?P<four>[\d.]+)"\)|inet_pton\(AF_INET6, "(?P<six>[^"]+)")'
)
NAMES = "53"  # port of name servers: one on this machine asks another one
WHY_NOT = "needs strace, and the right to trace"


@cache
def can_trace() -> bool:
    """Whether this machine has what it takes."""
    return (
        bool(shutil.which("strace"))
        and not subprocess.run(tracing("/dev/null", ["true"])).returncode
    )


def tracing(trace: Path | str, command: list) -> list:
    """A command whose sockets, and those of all that it starts, are written into a file."""
    return ["strace", "-f", "--seccomp-bpf", "-qq", "-e", CALLS, "-o", trace, *command]


def reached(trace: Path) -> set[str]:
    """Addresses beyond this machine, and name servers, that a traced program named."""
    found = set()
    for place in ADDRESS.finditer(trace.read_text(errors="replace")):
        address = place["four"] or place["six"]
        if place["port"] == NAMES or (address != "::" and not address.startswith(NEAR)):
            found.add(address)
    return found
