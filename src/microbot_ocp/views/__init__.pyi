"""Public names of the package; ``__init__.py`` loads them when they are asked for."""

from microbot_ocp.views import (
    plots as plots,
)
