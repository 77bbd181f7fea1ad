"""Silence of one thread."""

import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

from microbot_ocp._base.quiet import quiet


def test_silences_that_overlap_end_and_others_may_print(capsys):
    streams, both = (sys.stdout, sys.stderr), Barrier(2, timeout=10.0)

    def first() -> None:
        with quiet():
            print("silent", file=sys.stderr)
            both.wait()
            both.wait()  # the second is silent, too
        print("heard")
        both.wait()

    def second() -> None:
        both.wait()
        with quiet():
            both.wait()
            print("silent")
            both.wait()  # the first is not any more

    with ThreadPoolExecutor(2) as pool:
        for task in (pool.submit(first), pool.submit(second)):
            task.result()
    assert (sys.stdout, sys.stderr) == streams
    assert capsys.readouterr() == ("heard\n", "")
