"""A few photos at a time, in threads: the decoders and OpenCV release Python's lock."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

WORKERS = min(2, os.cpu_count() or 1)
"""As many photos are held in memory at a time; a RAW of 25 megapixels takes 300 MB."""


def in_parallel(do: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
    """Give the results in the order of the items, each as soon as it and those before are done."""
    pool = ThreadPoolExecutor(WORKERS)
    try:
        yield from pool.map(do, items)
    finally:  # when interrupted, those not begun are not waited for
        pool.shutdown(cancel_futures=True)
