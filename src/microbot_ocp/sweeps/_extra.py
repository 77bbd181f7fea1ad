"""Import of the libraries of the extra ``scale`` at their first use."""

from functools import partial

from microbot_ocp._base.needed import needed as needed_for

needed = partial(needed_for, purpose="sweeps need", extra="scale")
