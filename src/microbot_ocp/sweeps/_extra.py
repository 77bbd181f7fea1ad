"""The libraries of the extra ``scale``, imported when they are needed."""

from functools import partial

from microbot_ocp._base.needed import needed as needed_for

needed = partial(needed_for, purpose="sweeps need", extra="scale")
