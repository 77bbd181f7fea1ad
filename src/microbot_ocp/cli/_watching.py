"""Who follows a solve: the bar on a terminal, a viewer, a recording of the iterations."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from microbot_ocp._base.checks import InputError
from microbot_ocp.cli._options import writable
from microbot_ocp.cli._output import Written, shown_progress
from microbot_ocp.cli._recordings import check_viewer

if TYPE_CHECKING:
    from microbot_ocp.comparison import Progress, Step
    from microbot_ocp.views.recording import IterationRecorder


@dataclass(frozen=True)
class Watchers:
    """What the options ``--live``, ``--live-serve``, ``--live-connect`` and
    ``--rerun-iterations`` say; checked when it is made.
    """

    live: bool = False
    serve: bool = False
    connect: str | None = None
    iterations: Path | None = None
    written: Written = field(default_factory=Written)  # of the recording of the iterations
    _server: ExitStack = field(default_factory=ExitStack, repr=False)

    def __post_init__(self) -> None:
        if self.live + self.serve + (self.connect is not None) > 1:
            raise InputError("give one of --live, --live-serve and --live-connect")
        writable(self.iterations, ".rrd", "--rerun-iterations")
        if self.live or self.serve:
            check_viewer("--live" if self.live else "--live-serve", screen=self.live)
        if self.connect is not None:
            from microbot_ocp.views.live import parse_address

            parse_address(self.connect)

    @contextmanager
    def progress(self, as_json: bool) -> Iterator[Progress]:
        """A progress function that passes every step to all of them."""
        with ExitStack() as stack:
            watchers = [stack.enter_context(shown_progress(as_json))]
            if self.iterations is not None:
                from microbot_ocp.views.recording import record_iterations

                recording = record_iterations(self.iterations)
                watchers.append(recording.__enter__())
                stack.push(partial(self._end_recording, recording))
            if self.live or self.serve or self.connect is not None:
                watchers.append(stack.enter_context(self._viewer()))

            def forward(step: Step) -> None:
                for watcher in watchers:
                    watcher(step)

            try:
                yield forward
            except BaseException:
                self._server.close()
                raise

    def _viewer(self) -> AbstractContextManager[IterationRecorder]:
        from microbot_ocp.views import live

        if self.live:
            return live.spawned()
        address = self.connect or self._server.enter_context(live.server(_print_address))
        return live.connected(address)

    def _end_recording(self, recording: AbstractContextManager[Any], *problem: Any) -> None:
        """A recording that cannot be written does not lose the result."""
        if problem[0] is not None:
            recording.__exit__(*problem)
        else:
            self.written.add(self.iterations, lambda _: recording.__exit__(None, None, None))

    def linger(self) -> None:
        """Keep serving a browser until Ctrl-C."""
        if not self.serve:
            return
        print("Ctrl-C ends the server", file=sys.stderr, flush=True)
        with self._server, suppress(KeyboardInterrupt):
            while True:
                time.sleep(1.0)


def _print_address(address: str) -> None:
    print(f"open {address}", file=sys.stderr, flush=True)
