"""A CasADi optimal-control workbench for serial manipulators.

The public names stand in ``__init__.pyi``; each is loaded when it is first asked for.
"""

from microbot_ocp.lazy import load_on_demand

load_on_demand(__name__)
