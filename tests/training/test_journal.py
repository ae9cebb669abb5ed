import pytest

from training import journal
from training.config import TrainConfig


@pytest.fixture
def clock(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(journal.time, "monotonic", lambda: now[0])
    return now


def test_a_stopped_process_does_not_age(clock):
    watch = journal.StopWatch(10.0)
    for took_s in [0.1] * 50 + [600.0] + [0.1] * 50:
        clock[0] += took_s
        watch.lap()
    assert watch.elapsed_s == pytest.approx(10.0 + 101 * 0.1, abs=0.6)


def test_what_is_skipped_is_not_counted(clock):
    watch = journal.StopWatch(0.0)
    clock[0] += 50
    watch.skip()
    clock[0] += 0.2
    watch.lap()
    assert watch.elapsed_s == pytest.approx(0.2)


def test_something_is_due_once_per_period(clock):
    watch = journal.StopWatch(0.0)
    every = journal.Every(1.0, watch)
    due = []
    for _ in range(1300):
        clock[0] += 0.1
        watch.lap()
        due.append(every.due())
    assert sum(due) == 2


def test_a_run_ends_by_time_or_by_steps_whichever_is_first():
    config = TrainConfig(minutes=2.0, max_steps=100)
    assert journal.progress_of(50, 0.0, config) == 0.5
    assert journal.progress_of(0, 90.0, config) == 0.75
    assert journal.progress_of(500, 0.0, config) == 1.0
