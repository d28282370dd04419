import threading
import time

import pytest

from calibration.workers import WORKERS, in_parallel


def test_results_come_in_the_order_of_the_items():
    assert list(in_parallel(lambda n: n * n, range(50))) == [n * n for n in range(50)]
    assert list(in_parallel(str, [])) == []


def test_as_many_are_done_at_a_time_as_there_are_workers():
    together = threading.Barrier(WORKERS)
    # each waits until all workers are at it; a barrier that is not met raises
    assert len(list(in_parallel(lambda _: together.wait(10), range(WORKERS)))) == WORKERS


def test_an_error_of_one_item_reaches_the_caller():
    with pytest.raises(ZeroDivisionError):
        list(in_parallel(lambda n: 1 / n, [1, 0, 2]))


def test_items_not_begun_are_dropped_when_the_caller_stops():
    begun = []

    def slow(item):
        begun.append(item)
        time.sleep(0.02)
        return item

    results = in_parallel(slow, range(1000))
    assert next(results) == 0
    results.close()
    assert len(begun) < 100
