"""Speed against peers, as ratios measured in one run: ``python -m benchmarks``, ``make bench``."""

import sys
from pathlib import Path

# Tests prove that the peers' models equal ours; problems hold those of the report.
for folder in ("tests", "problems"):
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent / folder))
