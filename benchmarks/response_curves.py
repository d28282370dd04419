"""Recover response curves from rendered brackets, beside OpenCV's Debevec and Robertson.

    python benchmarks/response_curves.py [--crf ../shared/data/crf/responses_51.npz]
    python benchmarks/response_curves.py --memorial ../shared/data/brackets/memorial

Conditions: 7 exposures a factor 2 apart of a rendered scene (320x240, 1/f texture, standard
deviation 2.75 stops), noise 1/255 rms, 8 bit. The error is rms between brightness 12 and 243 of
255, in light where white is 1, after the best common factor. Without --crf the curves are random
members of the project's own families; no curve of --crf was used to choose anything in the fit.
"""

import argparse
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.brackets import read_bracket
from calibration.curve_fit import fit_curve
from calibration.response_curve import fit_channel, sampled_curve
from toolkit.response import decode_srgb

Array = NDArray[np.float64]
Curve = Callable[[Array], Array]

TIMES = 2.0 ** np.arange(-3, 4)
HEIGHT, WIDTH = 240, 320
NOISE = 1 / 255
JUDGED = np.arange(12, 244)
FAMILIES = 8
"""Random members of each family."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--crf", type=Path, help="measured curves, irradiance and brightness")
    parser.add_argument("--memorial", type=Path, help="folder of the memorial church's bracket")
    parser.add_argument("--only", type=int, help="so many curves of each kind")
    arguments = parser.parse_args()
    if arguments.memorial is not None:
        report_memorial(arguments.memorial)
        return
    curves = measured(arguments.crf) if arguments.crf is not None else families()
    report(curves, arguments.only)


def report(curves: Iterator[tuple[str, Curve]], only: int | None) -> None:
    rows = []
    print(
        f"{'curve':<14}{'ours':>10}{'Debevec':>10}{'Robertson':>11}{'held':>7}{'rises':>7}{'s':>6}"
    )
    for seed, (name, curve) in enumerate(curves):
        if only is not None and seed >= only:
            break
        row = judge(curve, np.random.default_rng(seed))
        rows.append(row)
        print(
            f"{name:<14}{row[0]:>10.5f}{row[1]:>10.5f}{row[2]:>11.5f}{row[3]:>7.2f}"
            f"{'yes' if row[4] else 'no':>7}{row[5]:>6.1f}",
            flush=True,
        )
    table = np.array(rows, dtype=float)
    for label, share in (("median", 0.5), ("95th", 0.95), ("largest", 1.0)):
        ours, debevec, robertson = np.quantile(table[:, :3], share, axis=0)
        print(f"{label:<14}{ours:>10.5f}{debevec:>10.5f}{robertson:>11.5f}")
    times = np.median(table[:, 1]) / np.median(table[:, 0])
    print(
        f"median of Debevec over ours {times:.1f}; truth within 1.96 of the stated standard ",
        end="",
    )
    print(f"deviation at {table[:, 3].mean():.3f} of the brightnesses; {len(table)} curves")


def judge(curve: Curve, generator: np.random.Generator) -> tuple[float, ...]:
    """Give the errors of ours, Debevec and Robertson, the share held, monotony and time."""
    pictures = photograph(curve, generator)
    light = np.append(0.0, np.logspace(-7, 0, 20_000))
    truth = np.interp(JUDGED / 255, *_rising(curve(light), light))
    start = time.perf_counter()
    fit = fit_curve(pictures.reshape(len(TIMES), -1) / 255, TIMES, 1 / 255)
    found, seen = sampled_curve(fit)
    seconds = time.perf_counter() - start
    ours = found(JUDGED / 255)
    off = scaled(ours, truth) - truth
    inside = (JUDGED / 255 > seen[0]) & (JUDGED / 255 < seen[1])
    held = np.abs(off) < 1.96 * np.interp(JUDGED / 255, found.brightness, found.std)
    frames = [np.repeat(picture[..., None], 3, axis=2) for picture in pictures]
    stated = TIMES.astype(np.float32)
    others = [
        maker.process(frames, stated)[JUDGED, 0, 0].astype(float)
        for maker in (cv2.createCalibrateDebevec(200, 10.0, True), cv2.createCalibrateRobertson())
    ]
    errors = [float(np.sqrt(np.mean((scaled(one, truth) - truth) ** 2))) for one in (ours, *others)]
    return (*errors, float(held[inside].mean()), bool((np.diff(found.exposure) > 0).all()), seconds)


def scaled(found: Array, truth: Array) -> Array:
    """Scale by the best common factor, which no bracket tells."""
    return found * float((found * truth).sum() / (found * found).sum())


def photograph(curve: Curve, generator: np.random.Generator) -> NDArray[np.uint8]:
    """Expose a textured scene [F, H, W]; its noise has 1/255 standard deviation."""
    waves = np.fft.rfft2(generator.normal(size=(HEIGHT, WIDTH)))
    size = np.hypot(np.fft.fftfreq(HEIGHT)[:, None], np.fft.rfftfreq(WIDTH)[None])
    size[0, 0] = 1
    texture = np.fft.irfft2(waves / size**1.2, s=(HEIGHT, WIDTH))
    light = 2 ** (2.75 * (texture - texture.mean()) / texture.std() - 3)
    seen = np.stack([curve(np.minimum(light * stop, 1)) for stop in TIMES])
    noisy = 255 * (seen + NOISE * generator.normal(size=seen.shape))
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def measured(path: Path) -> Iterator[tuple[str, Curve]]:
    with zipfile.ZipFile(path) as archive:
        names = ("irradiance.npy", "brightness.npy")
        irradiance, brightness = (_array(archive, name) for name in names)
    for index, row in enumerate(brightness):
        yield f"crf {index}", lambda x, row=row: np.interp(x, irradiance, row)


def families() -> Iterator[tuple[str, Curve]]:
    """Give power laws with toe and shoulder, display curves, film, knees and logarithms."""
    for kind in (power, display, film, knee, logarithm, contrast):
        for index in range(FAMILIES):
            generator = np.random.default_rng([index, len(kind.__name__)])
            yield f"{kind.__name__} {index}", from_black_to_white(kind(generator))


def power(generator: np.random.Generator) -> Curve:
    exponent, toe = 1 / generator.uniform(1, 2.8), 10 ** generator.uniform(-4, -2)
    shoulder = generator.uniform(0.01, 2.5)
    base = from_black_to_white(lambda x: (x + toe) ** exponent)
    return lambda x: 1 - np.exp(-shoulder * base(x))


def display(generator: np.random.Generator) -> Curve:
    bend = generator.uniform(0, 0.9)
    return lambda x: (1 - bend) * srgb(x) + bend * (3 * srgb(x) ** 2 - 2 * srgb(x) ** 3)


def film(generator: np.random.Generator) -> Curve:
    steepness, middle = generator.uniform(0.7, 2.2), 2 ** generator.uniform(-5, -1)
    return lambda x: 1 / (1 + (middle / np.maximum(x, 1e-9)) ** steepness)


def knee(generator: np.random.Generator) -> Curve:
    place, width = generator.uniform(0.6, 0.95), generator.uniform(0.01, 0.1)
    rest = generator.uniform(0.05, 0.4)
    base = srgb if generator.random() < 0.5 else np.sqrt
    return lambda x: base(x) - (1 - rest) * width * np.logaddexp(0, (base(x) - place) / width)


def logarithm(generator: np.random.Generator) -> Curve:
    scale = 10 ** generator.uniform(1, 3)
    return lambda x: np.log1p(scale * x)


def contrast(generator: np.random.Generator) -> Curve:
    exponent, middle = 1 / generator.uniform(1.4, 2.6), generator.uniform(0.3, 0.6)
    steepness = generator.uniform(3, 9)
    return lambda x: 1 / (1 + np.exp(-steepness * (np.maximum(x, 0) ** exponent - middle)))


def srgb(light: Array) -> Array:
    brightness = np.linspace(0, 1, 4001)
    return np.interp(light, decode_srgb(brightness), brightness)


def from_black_to_white(curve: Curve) -> Curve:
    black, white = curve(np.zeros(1))[0], curve(np.ones(1))[0]
    return lambda x: (curve(x) - black) / (white - black)


def report_memorial(folder: Path) -> None:
    """Print how far the exposures of a real bracket are from what its times say."""
    lines = [line.split() for line in (folder / "memorial.txt").read_text().splitlines()]
    paths, times = [folder / line[0] for line in lines], [1 / float(line[1]) for line in lines]
    bracket = read_bracket(paths, times)
    frames = [np.ascontiguousarray(cv2.imread(str(path))) for path in bracket.paths]
    stated = bracket.times.astype(np.float32)
    debevec = cv2.createCalibrateDebevec(200, 10.0, False).process(frames, stated)[:, 0, ::-1]
    print(f"{'channel':<9}{'':<9}{'rms EV':>8}{'frames rms EV':>15}{'largest EV':>12}{'rises':>7}")
    for channel in range(3):
        fit = fit_channel(bracket, channel)
        curves = (("ours", fit.curve.exposure), ("Debevec", debevec[:, channel].astype(float)))
        for name, exposure in curves:
            row = exposure_residual(bracket.values[channel], bracket.times, exposure)
            rises = "yes" if (np.diff(exposure) > 0).all() else "no"
            print(
                f"{'RGB'[channel]:<9}{name:<9}{row[0]:>8.3f}{row[1]:>15.3f}{row[2]:>12.3f}{rises:>7}"
            )


def exposure_residual(values: Array, times: Array, exposure: Array) -> tuple[float, float, float]:
    """Give, in stops, the rms of single values, and rms and largest of the frames' medians.

    Of brightness 0.1 to 0.9; places that stray by more than a stop (borders) are left out, and
    frames with under 1 % of the places.
    """
    stops = np.log2(np.interp(values * 255, np.arange(256), exposure))
    inside = (values > 0.1) & (values < 0.9)
    inside[:, inside.sum(0) < 2] = False
    light = stops - np.log2(times)[:, None]
    mean = np.where(inside, light, 0).sum(0) / np.maximum(inside.sum(0), 1)
    off = light - mean
    inside &= ~(inside & (np.abs(off) > 1)).any(0)
    enough = inside.sum(1) > 0.01 * values.shape[1]
    medians = np.array([np.median(off[k][inside[k]]) for k in np.flatnonzero(enough)])
    rms = float(np.sqrt(np.mean(off[inside] ** 2)))
    return rms, float(np.sqrt(np.mean(medians**2))), float(np.abs(medians).max())


def _rising(brightness: Array, light: Array) -> tuple[Array, Array]:
    rises = np.append(True, np.diff(np.maximum.accumulate(brightness)) > 0)
    return brightness[rises], light[rises]


def _array(archive: zipfile.ZipFile, name: str) -> Array:
    with archive.open(name) as file:
        values: Array = np.lib.format.read_array(file, allow_pickle=False)
    return values


if __name__ == "__main__":
    main()
