"""Speed against peers, as ratios measured in one run: ``python -m benchmarks``, ``make bench``."""

import sys
from pathlib import Path

# The peers' models are the ones that the tests prove equal to ours; problems hold the report's.
for folder in ("tests", "problems"):
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent / folder))
