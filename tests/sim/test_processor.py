"""Work in simulated time: when it ends, and what a starved processor makes of it."""

import pytest

from vwnav.sim.processor import LateExecutor, Processor, SimulatedClock, Worker


def test_work_takes_what_it_costs():
    assert Processor().end_of(2.0, 0.5) == 2.5


def test_a_third_of_the_processor_takes_three_times_as_long():
    processor = Processor()
    processor.starve(1.0, 10.0, 1.0 / 3.0)
    assert processor.end_of(1.0, 0.5) == pytest.approx(2.5)
    assert processor.end_of(0.5, 1.0) == pytest.approx(2.5)  # half of it was done before


def test_work_waits_for_a_processor_that_is_all_taken():
    processor = Processor()
    processor.starve(1.0, 4.0, 0.0)
    assert processor.end_of(2.0, 0.5) == 4.5
    assert processor.end_of(0.9, 0.2) == pytest.approx(4.1)


def beats(worker: Worker, seconds: float, step_s: float = 0.004) -> list[float]:
    times = [round(i * step_s, 6) for i in range(round(seconds / step_s))]
    return [t_s for t_s in times if worker.due(t_s)]


def test_a_worker_keeps_its_rate():
    assert len(beats(Worker(Processor(), lambda: 0.001, 0.02, 0.0), 10.0)) == pytest.approx(
        500, abs=2
    )


def test_a_worker_that_was_starved_goes_on_and_does_not_catch_up():
    processor = Processor()
    processor.starve(1.0, 3.0, 0.0)
    times = beats(Worker(processor, lambda: 0.001, 0.05, 0.0), 4.0)
    assert not [t_s for t_s in times if 1.05 < t_s < 3.0]
    assert len([t_s for t_s in times if t_s >= 3.0]) == pytest.approx(20, abs=2)


def test_a_worker_that_is_stopped_sleeps():
    worker = Worker(Processor(), lambda: 0.001, 0.05, 0.0)
    assert beats(worker, 1.0)
    worker.sleep_until(5.0)
    assert not [t_s for t_s in beats(worker, 6.0) if t_s < 5.0]


def test_a_late_result_is_there_when_the_work_would_have_ended():
    clock = SimulatedClock(1.0)
    future = LateExecutor(clock, Processor(), lambda x: 0.09).submit(lambda x: x + 1, 1)
    assert not future.done()
    clock.now_s = 1.1
    assert future.done()
    assert future.result() == 2


def test_one_call_comes_after_the_other():
    clock = SimulatedClock()
    executor = LateExecutor(clock, Processor(), lambda: 1.0)
    executor.submit(lambda: None)
    second = executor.submit(lambda: None)
    clock.now_s = 1.5
    assert not second.done()
    clock.now_s = 2.0
    assert second.done()


def test_what_a_call_raised_comes_as_late():
    clock = SimulatedClock()
    future = LateExecutor(clock, Processor(), lambda: 0.5).submit(lambda: 1 / 0)
    clock.now_s = 0.6
    assert future.done()
    assert isinstance(future.exception(), ZeroDivisionError)
