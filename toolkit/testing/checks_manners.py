"""Checks of an estimator's manners: precision, repeatability, options, global state, cost."""

import math
import random
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import FrozenInstanceError, dataclass, fields, replace
from typing import Any, get_args, get_origin

import numpy as np
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from toolkit.alpha import AlphaEstimator, Chord, Observation
from toolkit.errors import ToolkitError
from toolkit.option_text import can_be_text, format_option, parse_option
from toolkit.registry import name_of, option_kinds
from toolkit.testing.case import Case, CheckFailed, chords, each_part, expect
from toolkit.types import LinearImage, NoiseModel

SLOWER, SECONDS = 20.0, 0.1
"""An estimator may take so many times what one of a single colour takes, and so long anyway."""
LARGER, BYTES = 40, 64_000_000
"""The same of the largest piece of memory."""


def precision_kept(case: Case) -> None:
    """What comes in double precision is answered in double, and single in single."""
    for dtype in (torch.float32, torch.float64):
        image, background = (
            replace(picture, rgb=picture.rgb.to(dtype))
            for picture in (case.sample.image, case.sample.background)
        )
        seen = case.observe(image, background)
        each_part(
            lambda part, seen=seen, dtype=dtype: getattr(seen, part).dtype == dtype,  # type: ignore[misc]
            f"of a picture in {dtype} is in another precision",
        )
        value, slope = case.slope(chords(dtype=dtype))
        for name, found in (("foreground", case.foreground(chords(dtype=dtype))), ("value", value)):
            expect(found.dtype == dtype, f"{name} is {found.dtype} for offsets in {dtype}")
        expect(slope is None or slope.dtype == dtype, f"the slope is not {dtype}")


def repeatable(case: Case) -> None:
    """The same question gets the same answer, bit by bit."""
    first, second = case.observe(), case.observe()
    each_part(
        lambda part: torch.equal(getattr(first, part), getattr(second, part)),
        "differs when the same picture is observed again",
    )
    expect(
        torch.equal(case.foreground(chords()), case.foreground(chords())),
        "the foreground differs when asked again",
    )


def threads_kept(case: Case) -> None:
    """The number of torch's threads is left alone."""
    before = torch.get_num_threads()
    try:
        case.use()
        after = torch.get_num_threads()
    finally:
        torch.set_num_threads(before)
    expect(after == before, f"torch had {before} threads before and {after} after")


def state_kept(case: Case) -> None:
    """Random numbers, default precision and the recording of gradients are left alone."""
    before = _state()
    try:
        case.use()
        after = _state()
    finally:
        _restore(before)
    changed = [name for name in before if not _is_same(before[name], after[name])]
    expect(not changed, f"changed after use: {', '.join(changed)}")


def options_round_trip(case: Case) -> None:
    """Options written as text make an equal estimator, and nobody can change one that is made."""
    estimator = case.estimator
    kinds = option_kinds(name_of(type(estimator)), type(estimator))
    again = {}
    for name, kind in kinds.items():
        value = getattr(estimator, name)
        again[name] = value
        if can_be_text(kind):
            again[name] = parse_option(format_option(value), kind, name)
    expect(type(estimator)(**again) == estimator, "options read back make another estimator")
    for field in fields(estimator):
        try:
            setattr(estimator, field.name, getattr(estimator, field.name))
        except (FrozenInstanceError, AttributeError):
            continue
        raise CheckFailed(f"field '{field.name}' can be changed; add frozen=True to @dataclass")


def options_refused(case: Case) -> None:
    """An option that is no number is refused with an error of the toolkit's own, in one line."""
    estimator = case.estimator
    kinds = option_kinds(name_of(type(estimator)), type(estimator))
    for name, kind in kinds.items():
        nonsense = _nonsense(kind)
        if nonsense is None:
            continue
        try:
            replace(estimator, **{name: nonsense})
        except ToolkitError as error:
            expect("\n" not in str(error), f"{name} = {nonsense} is refused in several lines")
        except Exception as error:  # a stranger's code may raise anything
            raise CheckFailed(
                f"{name} = {nonsense} breaks with {type(error).__name__}; raise ConfigError with "
                "what to do"
            ) from error
        else:
            raise CheckFailed(f"{name} = {nonsense} is accepted; raise ConfigError")


def cost(case: Case) -> None:
    """Time and memory stay within a generous multiple of what an estimator of one colour needs."""
    plain = Case(estimator=_OneColour(), sample=case.sample)
    many = chords(300, 70)
    for name, own, other in (
        ("observe", case.observe, plain.observe),
        ("foreground", lambda: case.slope(many), lambda: plain.slope(many)),
    ):
        seconds, limit = _seconds(own), max(SECONDS, SLOWER * _seconds(other))
        expect(seconds <= limit, f"{name} takes {seconds:.3f} s; {limit:.3f} s are allowed")
        size, most = _largest(own), max(BYTES, LARGER * _largest(other))
        expect(
            size <= most,
            f"{name} takes {size / 1e6:.0f} MB at once; {most / 1e6:.0f} MB are allowed",
        )


def _nonsense(kind: Any) -> Any:
    """Give a value of the kind that holds a NaN; None for kinds that cannot."""
    kinds = [part for part in get_args(kind) if part is not type(None)] or [kind]
    if get_origin(kind) is tuple or kind is float:
        kinds = [kind]
    (first, *_) = kinds
    if first is float:
        return math.nan
    parts = get_args(first) if get_origin(first) is tuple else ()
    if not parts or any(part not in (float, Ellipsis) for part in parts):
        return None
    return tuple(math.nan for part in parts if part is float)


def _state() -> dict[str, object]:
    return {
        "torch's random numbers": torch.get_rng_state(),
        "numpy's random numbers": np.random.get_state(),  # noqa: NPY002  (a stranger may use it)
        "Python's random numbers": random.getstate(),
        "the default precision": torch.get_default_dtype(),
        "the recording of gradients": torch.is_grad_enabled(),
        "deterministic algorithms": torch.are_deterministic_algorithms_enabled(),
    }


def _restore(state: dict[str, Any]) -> None:
    torch.set_rng_state(state["torch's random numbers"])
    np.random.set_state(state["numpy's random numbers"])  # noqa: NPY002
    random.setstate(state["Python's random numbers"])
    torch.set_default_dtype(state["the default precision"])
    torch.set_grad_enabled(state["the recording of gradients"])
    torch.use_deterministic_algorithms(state["deterministic algorithms"])


def _is_same(first: object, second: object) -> bool:
    if isinstance(first, Tensor):
        return isinstance(second, Tensor) and torch.equal(first, second)
    return repr(first) == repr(second)


def _seconds(work: Callable[[], object]) -> float:
    """Least time of three, after one to warm up."""
    work()
    times = []
    for _ in range(3):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def _largest(work: Callable[[], object]) -> int:
    """Bytes of the largest tensor that torch made, or of all that Python and numpy held at once."""
    watch = _Watch()
    tracemalloc.start()
    try:
        with watch:
            work()
        held = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    return max(held, watch.largest)


class _Watch(TorchFunctionMode):
    """Notes the size of the largest tensor that any function of torch gives."""

    def __init__(self) -> None:
        super().__init__()
        self.largest = 0

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run the function and look at what it gives."""
        found = func(*args, **(kwargs or {}))
        if isinstance(found, Tensor):
            self.largest = max(self.largest, found.numel() * found.element_size())
        return found


@dataclass(frozen=True, kw_only=True)
class _OneColour(AlphaEstimator):
    """What costs are compared with."""

    def observe(
        self, image: LinearImage, background: LinearImage, noise: NoiseModel
    ) -> Observation:
        variance = noise.variance(image.rgb) + noise.variance(background.rgb)
        return Observation(signal=image.rgb, ground=background.rgb, variance=variance)

    def foreground(self, chord: Chord, appearance: Tensor | None) -> Tensor:
        return chord.offset.new_full((3,), 0.5).expand(*chord.offset.shape, 3)
