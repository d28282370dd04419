"""The result of a measurement: plain numbers that can be stored, compared and read anywhere.

Camera frame x right, y down, z forward, metres, seconds; pixels (x, y) of the stored picture,
(0, 0) at the centre of the top-left pixel. The JSON has the fields in the order written here; a
value that is not known is null (None), and so is a number in a list that is not finite (NaN).
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from toolkit.about import installed_version
from toolkit.errors import ConfigError
from toolkit.files import one_line
from toolkit.plain_data import from_plain, to_plain

SCHEMA = "toolkit.measurement/1"
MAX_JSON_BYTES = 64 * 1024 * 1024

Vector = tuple[float, float, float]
Pixel = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class InputFile:
    """A file that went into the measurement, and the SHA-256 of its contents."""

    path: str
    sha256: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """The files measured; empty when arrays were handed in."""

    shot: InputFile | None = None
    background: tuple[InputFile, ...] = ()
    camera: InputFile | None = None
    ball: tuple[InputFile, ...] = ()  # its file and sharp picture, where these were read


@dataclass(frozen=True, slots=True, kw_only=True)
class Alternative:
    """Another branch of the motion that explains the picture too."""

    direction: Vector  # unit
    velocity_m_s: Vector | None  # None without an exposure time
    probability: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Sign:
    """Which way the ball went along its path: one picture alone leaves this open."""

    ambiguous: bool
    probability: float  # of the branch reported
    cue: str | None = None  # what tells it, such as "readout"; None where nothing does
    alternatives: tuple[Alternative, ...] = ()  # the branches not reported


@dataclass(frozen=True, slots=True, kw_only=True)
class PathSamples:
    """The path of the ball's centre; time and velocity are None without an exposure time."""

    time_s: tuple[float, ...] | None  # [N] from the start of the first row's exposure
    position_m: tuple[Vector, ...]  # [N]
    velocity_m_s: tuple[Vector, ...] | None  # [N]
    position_std_m: tuple[Vector, ...]  # [N]


@dataclass(frozen=True, slots=True, kw_only=True)
class ContourPoints:
    """The streak's two sides, left and right when walking along the reported motion."""

    left: tuple[Pixel, ...]  # [N] px
    right: tuple[Pixel, ...]  # [N] px


@dataclass(frozen=True, slots=True, kw_only=True)
class ProfileTable:
    """One row a profile: its semi-ellipse, and the bits of ProfileFlag against it (0 is good)."""

    centre_px: tuple[Pixel, ...]  # [P]
    half_width_px: tuple[float, ...]  # [P]
    opacity: tuple[float, ...]  # [P]
    flags: tuple[int, ...]  # [P]


@dataclass(frozen=True, slots=True, kw_only=True)
class Shares:
    """Where a variance comes from, in shares that sum to 1; None for a source not looked at."""

    noise: float | None = None
    camera: float | None = None
    radius: float | None = None
    exposure: float | None = None
    response: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """The sources of the variance of the speed (None when there is no speed) and of the depth."""

    speed: Shares | None
    depth: Shares


@dataclass(frozen=True, slots=True, kw_only=True)
class Bound:
    """The Cramer-Rao bound: what the noise of this picture leaves open, however it is measured."""

    position_std_m: Vector
    speed_std_m_s: float | None
    efficiency: float | None  # the bound's variance of the depth over that reported; 1 is best


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualMap:
    """What the exact streak leaves unexplained in small patches before which the ball passed."""

    place_px: tuple[Pixel, ...]  # [B] middle of the patch
    sigma: tuple[float, ...]  # [B] error of its opacity in standard deviations: 1 is noise


@dataclass(frozen=True, slots=True, kw_only=True)
class FitSummary:
    """How well the model explains the samples."""

    chi2_per_dof: float
    pixels: int  # samples that entered the fit
    iterations: int
    appearance: tuple[float, ...] | None = None  # what the estimator left open, such as a colour
    blur_px: float | None = None  # standard deviation of the lens's point spread, where fitted
    residuals: ResidualMap | None = None  # of the exact streak


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """An estimator that was tried, and how well it predicted pixels it was not shown."""

    estimator: str
    score: float | None = None  # mean squared error over noise, 1 is perfect; None where it failed
    edge_std_px: float | None = None  # of one profile, as fitted
    reason: str | None = None  # why it failed


@dataclass(frozen=True, slots=True, kw_only=True)
class Caution:
    """Something the reader of a result must know; `code` is for programs, `message` for people."""

    code: str
    message: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """Position, direction, speed and path of the ball in one picture, each with its uncertainty.

    The state is that of the middle of the exposure (of the ball's own row, where rows were read one
    after another), on the branch reported: where the sign of the motion is open that is the one
    moving right in the picture, or down, or away. `numbers` turns tensors into what the fields
    take.
    """

    schema: ClassVar[str] = SCHEMA

    version: str = field(default_factory=installed_version)
    status: str = "ok"  # or "refused"
    reason: str | None = None  # why it was refused
    inputs: Inputs = field(default_factory=Inputs)
    estimator: str | None = None  # as it is declared; else its class, in lower case with hyphens
    stage: str | None = None  # the last that shaped the result: "profiles", "contours" or "sweep"
    time_s: float | None = None  # of the state, as in PathSamples; None without an exposure time
    position_m: Vector | None = None
    position_std_m: Vector | None = None
    velocity_m_s: Vector | None = None
    direction: Vector | None = None  # unit
    speed_m_s: float | None = None
    speed_std_m_s: float | None = None
    speed_upper_m_s: float | None = None  # with 95 % certainty, where the ball may have stood still
    state_covariance: tuple[tuple[float, ...], ...] | None = None  # [6][6] of x y z vx vy vz
    sign: Sign | None = None
    trajectory: PathSamples | None = None
    contours: ContourPoints | None = None
    profiles: ProfileTable | None = None
    budget: Budget | None = None
    bound: Bound | None = None
    fit: FitSummary | None = None
    candidates: tuple[Candidate, ...] = ()  # tried where the estimator was to be chosen, best first
    provenance: Mapping[str, str] = field(default_factory=dict)  # measured, assumed or inferred
    warnings: tuple[Caution, ...] = ()
    timing_s: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def refused(
        cls,
        reason: str,
        *,
        inputs: Inputs | None = None,
        estimator: str | None = None,
        warnings: tuple[Caution, ...] = (),
    ) -> "Measurement":
        """Make the result of a shot that cannot be measured: no numbers, and the reason."""
        return cls(
            status="refused",
            reason=reason,
            inputs=inputs or Inputs(),
            estimator=estimator,
            warnings=warnings,
        )

    def to_json(self) -> str:
        """Write the measurement as one JSON object; no key is ever missing, no number ever NaN.

        One line of ASCII: any terminal can print it, even with a file name that is not valid text.
        """
        return json.dumps({"schema": SCHEMA, **to_plain(self)}, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> "Measurement":
        """Read what `to_json` wrote.

        Raises:
            ConfigError: when the text is not JSON, too large or of another schema, or a key is
                missing, unknown or of another type.
        """
        if len(text) > MAX_JSON_BYTES:
            raise ConfigError(f"a measurement of more than {MAX_JSON_BYTES} characters is not read")
        try:
            table: Any = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise ConfigError(
                f"the measurement is not valid JSON ({one_line(error)}); measure the shot again"
            ) from None
        schema = table.pop("schema", None) if isinstance(table, dict) else None
        if schema != SCHEMA:
            raise ConfigError(f'schema is {schema!r}; a measurement has schema = "{SCHEMA}"')
        measurement: Measurement = from_plain(cls, table, "measurement")
        return measurement


def numbers(values: Any) -> Any:
    """Turn a tensor or array into nested tuples of plain numbers, a single element into one number.

    Example:
        >>> import torch
        >>> numbers(torch.tensor([[1.0, 2.0], [3.0, 4.0]]))
        ((1.0, 2.0), (3.0, 4.0))
    """
    return _tuples(values.tolist(), values.ndim)


def _tuples(values: Any, depth: int) -> Any:
    if depth < 2:
        return tuple(values) if depth else values
    return tuple(_tuples(value, depth - 1) for value in values)
