"""Windows for the code of this project, on another system: what Python lacks there is hidden.

Python runs this file at its start if its folder is on ``PYTHONPATH``, also in child processes. The
standard library and installed packages still see the true system.
"""

import builtins
import contextlib
import os
import signal
import subprocess
import sys
import types
import warnings
from pathlib import Path

MODULES = {"fcntl", "grp", "pty", "pwd", "resource", "termios", "tty", "_posixsubprocess"}
MISSING = {
    "os": """
        O_CLOEXEC O_DIRECTORY O_NOFOLLOW O_NONBLOCK WEXITSTATUS WIFSIGNALED WNOHANG WTERMSIG
        chown confstr fchmod fchown fork forkpty getegid geteuid getgid getpgid getpgrp getpriority
        getresuid getsid getuid killpg lockf mkfifo mknod nice openpty posix_fadvise posix_spawn
        register_at_fork sched_getaffinity sched_setaffinity setpgid setpriority setsid
        sync sysconf uname wait wait3 wait4 waitid""",
    "signal": """
        ITIMER_PROF ITIMER_REAL ITIMER_VIRTUAL SIGALRM SIGBUS SIGCHLD SIGCONT SIGHUP SIGKILL
        SIGPIPE SIGPROF SIGQUIT SIGSTOP SIGTSTP SIGTTIN SIGTTOU SIGUSR1 SIGUSR2 SIGVTALRM SIGWINCH
        SIGXCPU SIGXFSZ SIG_BLOCK SIG_SETMASK SIG_UNBLOCK alarm getitimer pause pthread_kill
        pthread_sigmask setitimer siginterrupt sigpending sigtimedwait sigwait""",
    "time": "clock_gettime clock_settime pthread_getcpuclockid tzset",
    "sys": "getdlopenflags setdlopenflags",
    "mmap": "MAP_ANONYMOUS MAP_PRIVATE MAP_SHARED PROT_READ PROT_WRITE",
    "socket": "AF_UNIX",
    "subprocess": "",
}
PROJECT = str(Path(__file__).parents[3])
SITE = ("site-packages", "dist-packages", ".venv")
_read_only: set[int] = set()  # files that are open for reading alone


class Seen(types.ModuleType):
    """Module without the names that Windows lacks."""

    def __init__(self, module, **replaced):
        super().__init__(module.__name__)
        hidden = frozenset(MISSING[module.__name__].split())
        object.__setattr__(self, "_seen", (module, hidden, replaced))

    def __getattribute__(self, name):
        module, hidden, replaced = object.__getattribute__(self, "_seen")
        if name in hidden:
            raise AttributeError(f"module {module.__name__!r} of Windows has no {name!r}")
        return replaced[name] if name in replaced else getattr(module, name)

    def __setattr__(self, name, value):
        setattr(object.__getattribute__(self, "_seen")[0], name, value)


def _open(path, flags, *rest, **named):
    if os.path.isdir(path):
        raise PermissionError(13, "Permission denied", str(path))
    handle = os.open(path, flags, *rest, **named)
    (_read_only.add if not flags & (os.O_WRONLY | os.O_RDWR) else _read_only.discard)(handle)
    return handle


def _fsync(handle):
    if handle in _read_only:
        raise OSError(9, "Bad file descriptor")
    os.fsync(handle)


def _kill(pid, number):
    raise AssertionError(f"os.kill({pid}, {number}) ends the process on Windows")


def _times():
    return os.times_result((*os.times()[:2], 0.0, 0.0, 0.0))


class _Popen(subprocess.Popen):
    def __init__(self, command, *rest, creationflags=0, **named):
        for name in ("pass_fds", "preexec_fn", "process_group", "umask", "user"):
            if named.get(name):
                raise ValueError(f"{name} is not supported on Windows platforms")
        named.pop("start_new_session", None)  # Windows ignores it
        super().__init__(command, *rest, **named)


def _run(command, **named):
    if command[:3] == ["taskkill", "/F", "/T"]:
        with contextlib.suppress(ProcessLookupError):
            os.kill(int(command[-1]), signal.SIGKILL)
        return subprocess.CompletedProcess(command, 0, b"", b"")
    return subprocess.run(command, **named)


_SEEN = {
    "os": Seen(os, open=_open, fsync=_fsync, kill=_kill, times=_times),
    "signal": Seen(signal),
    "subprocess": Seen(subprocess, Popen=_Popen, run=_run),
    "sys": Seen(sys, platform="win32"),
}
_import = builtins.__import__


def _seen_import(name, globals=None, locals=None, fromlist=(), level=0):
    file = str((globals or {}).get("__file__", ""))
    ours = file.startswith(PROJECT) and not any(part in file for part in SITE)
    ours = ours or (globals or {}).get("__name__") == "__main__"
    if not ours or level:
        return _import(name, globals, locals, fromlist, level)
    if name.partition(".")[0] in MODULES:
        raise ModuleNotFoundError(f"Windows has no module {name!r}", name=name)
    module = _import(name, globals, locals, fromlist, level)
    top = module.__name__
    if top not in MISSING:
        return module
    if top not in _SEEN:
        _SEEN[top] = Seen(module)
    return _SEEN[top]


def _check_name(event, arguments):
    """Refuse to create files with names that Windows does not allow."""
    if event == "open" and isinstance(arguments[0], str) and set(str(arguments[1])) & set("wax"):
        name = os.path.basename(arguments[0])
        if set(name) & set('<>:"|?*\\') or name.endswith((" ", ".")):
            raise AssertionError(f"Windows has no file with the name {name!r}")


builtins.__import__ = _seen_import
# With PYTHONWARNDEFAULTENCODING: text files of Windows are not UTF-8 by default.
warnings.simplefilter("ignore", EncodingWarning)
warnings.filterwarnings("error", category=EncodingWarning, module="microbot_ocp")
sys.addaudithook(_check_name)
