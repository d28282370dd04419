"""A few photos at a time, in threads: the decoders and OpenCV release Python's lock."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

WORKERS = min(4, os.cpu_count() or 1)
"""As many photos are held in memory at a time."""


def in_parallel(do: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
    """Give the results in the order of the items, each as soon as it and those before are done."""
    with ThreadPoolExecutor(WORKERS) as pool:
        yield from pool.map(do, items)
