"""Pickles of what holds expressions of CasADi, for other processes.

CasADi writes an expression into a context, in which a symbol stays one symbol in all expressions.
The outermost object that is pickled has a context of its own; the objects in it are written there.
"""

from __future__ import annotations

import copy
import pickle
import threading
from typing import Any, Self

import casadi as ca

_here = threading.local()  # as CasADi's contexts are
# a class name of CasADi's, as it writes bytes: a letter for four bits, the lower ones first
_CALLBACK = b"".join(bytes((97 + (k & 15), 97 + (k >> 4))) for k in b"CallbackInternal")


class Portable:
    """An object with expressions; copies in the same process share its symbols."""

    def __reduce_ex__(self, protocol: Any) -> Any:
        if getattr(_here, "writes", False):
            return object.__reduce_ex__(self, protocol)
        _here.writes = True
        try:
            with ca.global_pickle_context():
                content = pickle.dumps(self, protocol)
        finally:
            _here.writes = False
        if _CALLBACK in content:  # CasADi writes it, and cannot read it
            raise pickle.PicklingError(
                f"{type(self).__name__} cannot be pickled: its expressions call a function of "
                "Python (numeric_function, casadi.Callback), which stays in its process; declare "
                "the problem in the other one"
            )
        return _restored, (content,)

    def __copy__(self) -> Self:
        return self._copied(self.__dict__)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        memo[id(self)] = new = self._copied({})
        new.__dict__.update(copy.deepcopy(self.__dict__, memo))
        return new

    def _copied(self, state: dict[str, Any]) -> Self:
        new = object.__new__(type(self))
        new.__dict__.update(state)
        return new


def _restored(content: bytes) -> Any:
    with ca.global_unpickle_context():
        return pickle.loads(content)
