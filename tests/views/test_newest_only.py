import threading

from microbot_ocp.views.live import NewestOnly


def test_of_a_burst_the_first_and_the_last_are_done():
    began, go_on, done = threading.Event(), threading.Event(), []

    def job(request):
        began.set()
        assert go_on.wait(10)
        done.append(request)

    work = NewestOnly(job)
    work.ask(0)
    assert began.wait(10)
    for request in range(1, 50):
        work.ask(request)
    assert not work.wait(timeout=0.01)
    go_on.set()
    assert work.wait(timeout=10)
    assert done == [0, 49]


def test_it_can_be_asked_again_and_waited_for_when_idle():
    done = []
    work = NewestOnly(done.append)
    assert work.wait(timeout=0)
    for request in (1, 2):
        work.ask(request)
        assert work.wait(timeout=10)
    assert done == [1, 2]


def test_a_job_that_fails_holds_up_nobody_and_is_logged(caplog):
    work = NewestOnly(lambda request: 1 / request)
    work.ask(0)
    assert work.wait(timeout=10)
    work.ask(1)
    assert work.wait(timeout=10)
    assert [record.exc_info[0] for record in caplog.records] == [ZeroDivisionError]
