"""Objects with CasADi expressions that can be pickled for other processes.

CasADi writes expressions into a context, which preserves symbols that several expressions share.
The outermost pickled object opens a context, into which the objects inside of it are written.
"""

from __future__ import annotations

import copy
import pickle
import threading
from typing import Any, Self

import casadi as ca

_here = threading.local()  # CasADi's contexts belong to a thread, too
# CasADi writes each byte of the class name as two letters, the lower four bits first.
_CALLBACK = b"".join(bytes((97 + (k & 15), 97 + (k >> 4))) for k in b"CallbackInternal")


class Portable:
    """An object with expressions; its copies in one process share its symbols."""

    def __reduce_ex__(self, protocol: Any) -> Any:
        if getattr(_here, "writes", False):
            return object.__reduce_ex__(self, protocol)
        _here.writes = True
        try:
            with ca.global_pickle_context():
                content = pickle.dumps(self, protocol)
        finally:
            _here.writes = False
        if _CALLBACK in content:  # CasADi can write a callback but not read it
            raise pickle.PicklingError(
                f"{type(self).__name__} cannot be pickled: its expressions call a function of "
                "Python (numeric_function, casadi.Callback), which stays in its process; declare "
                "the problem in the other one"
            )
        return _restored, (content,)

    def __copy__(self) -> Self:
        new = object.__new__(type(self))
        new.__dict__.update(self.__dict__)
        return new

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        memo[id(self)] = new = object.__new__(type(self))
        new.__dict__.update(copy.deepcopy(self.__dict__, memo))
        return new


def _restored(content: bytes) -> Any:
    with ca.global_unpickle_context():
        return pickle.loads(content)
