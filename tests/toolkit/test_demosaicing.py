import numpy as np
import pytest

from toolkit.demosaicing import DEMOSAICERS, demosaic, superpixels
from toolkit.errors import ConfigError, ShapeError

PATTERNS = [((0, 1), (1, 2)), ((1, 0), (2, 1)), ((2, 1), (1, 0)), ((1, 2), (0, 1))]
XTRANS = (
    (1, 0, 1, 1, 2, 1),
    (2, 1, 2, 0, 1, 0),
    (1, 0, 1, 1, 2, 1),
    (1, 2, 1, 1, 0, 1),
    (0, 1, 0, 2, 1, 2),
    (1, 2, 1, 1, 0, 1),
)


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def by_hand(mosaic, pattern, weights):
    """Average each colour's measured neighbours; beyond the border the picture is mirrored."""
    height, width = mosaic.shape
    reach = weights.shape[0] // 2
    rgb = np.zeros((3, height, width))
    for y in range(height):
        for x in range(width):
            total, weight = np.zeros(3), np.zeros(3)
            for dy in range(-reach, reach + 1):
                for dx in range(-reach, reach + 1):
                    row, column = abs(y + dy), abs(x + dx)
                    row = 2 * (height - 1) - row if row >= height else row
                    column = 2 * (width - 1) - column if column >= width else column
                    channel = pattern[row % len(pattern)][column % len(pattern[0])]
                    total[channel] += weights[dy + reach, dx + reach] * mosaic[row, column]
                    weight[channel] += weights[dy + reach, dx + reach]
            rgb[:, y, x] = total / weight
            here = pattern[y % len(pattern)][x % len(pattern[0])]
            rgb[here, y, x] = mosaic[y, x]
    return rgb


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("shape", [(8, 10), (9, 7), (2, 2)])
def test_bayer_is_bilinear_up_to_the_border(rng, pattern, shape):
    mosaic = rng.normal(size=shape).astype(np.float32)
    weights = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]])
    expected = by_hand(mosaic, pattern, weights)
    np.testing.assert_allclose(demosaic(mosaic, pattern), expected, atol=1e-6)


def test_xtrans_averages_what_is_near(rng):
    mosaic = rng.normal(size=(17, 20)).astype(np.float32)
    weights = np.outer([1, 2, 3, 2, 1], [1, 2, 3, 2, 1])
    expected = by_hand(mosaic, XTRANS, weights)
    inner = (slice(None), slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(demosaic(mosaic, XTRANS)[inner], expected[inner], atol=1e-6)


@pytest.mark.parametrize("pattern", [*PATTERNS, XTRANS])
def test_linear_and_exact_for_flat_colours(rng, pattern):
    first, second = rng.normal(size=(2, 13, 14)).astype(np.float32)
    both = demosaic(2 * first - second, pattern)
    np.testing.assert_allclose(
        both, 2 * demosaic(first, pattern) - demosaic(second, pattern), atol=1e-5
    )
    colour = np.array([0.1, -0.2, 0.7], np.float32)
    rows, columns = np.indices((13, 14))
    flat = colour[np.asarray(pattern)[rows % len(pattern), columns % len(pattern[0])]]
    np.testing.assert_allclose(
        demosaic(flat, pattern), np.broadcast_to(colour[:, None, None], (3, 13, 14)), atol=1e-6
    )


def test_unknown_method_names_the_known_ones():
    assert list(DEMOSAICERS) == ["bilinear"]
    with pytest.raises(ConfigError, match="'magic' is unknown; use one of bilinear"):
        demosaic(np.zeros((4, 4), np.float32), PATTERNS[0], "magic")


@pytest.mark.parametrize(("pattern", "size"), [*((p, 4) for p in PATTERNS), (XTRANS, 6)])
def test_superpixels_average_what_each_colour_measured(rng, pattern, size):
    mosaic = rng.normal(size=(3 * size + 1, 4 * size + 3)).astype(np.float32)
    rows, columns = np.indices(mosaic.shape)
    channels = np.asarray(pattern)[rows % len(pattern), columns % len(pattern)]
    reduced = superpixels(mosaic, pattern, size)
    assert (reduced.shape, reduced.dtype) == ((3, 3, 4), np.float32)
    for y, x in np.ndindex(3, 4):
        block = (slice(y * size, (y + 1) * size), slice(x * size, (x + 1) * size))
        means = [mosaic[block][channels[block] == channel].mean() for channel in range(3)]
        np.testing.assert_allclose(reduced[:, y, x], means, atol=1e-5)


def test_superpixels_hold_whole_periods():
    with pytest.raises(ShapeError, match="size is 3 px, but whole periods of 2 px are needed"):
        superpixels(np.zeros((8, 8), np.float32), PATTERNS[0], 3)
