"""Pictures, tables and recordings of a comparison; nothing here is imported unless it is asked for.

``plots`` needs matplotlib, ``recording`` needs rerun, ``tables`` needs rich.
"""

from microbot_ocp.lazy import load_on_demand

load_on_demand(__name__)
