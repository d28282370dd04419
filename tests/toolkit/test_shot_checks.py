from pathlib import Path
from types import SimpleNamespace

import pytest

from toolkit import ConfigError, MismatchError
from toolkit.rig import Rig
from toolkit.shot_checks import check_numbers, check_readout, check_roi, check_size


def test_numbers_in_range_pass_and_so_do_those_nobody_told():
    check_numbers(0.036, Rig())
    check_numbers(0.036, Rig(exposure=0.01, exposure_std=0.0, readout=0.0, ball_radius_std=1e-4))


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (Rig(exposure=0.0), "the exposure time is 0 s; a number from 1e-09 to 100000 s"),
        (Rig(readout=-0.01), "the readout time is -0.01 s; a number from 0 to 100000 s"),
        (Rig(readout=float("nan")), "the readout time is nan s"),
        (Rig(readout=float("inf")), "the readout time is inf s"),
        (Rig(exposure_std=float("inf")), "deviation of the exposure time is inf s; zero or"),
    ],
)
def test_a_number_out_of_range_is_named(settings, reason):
    with pytest.raises(ConfigError, match=reason):
        check_numbers(0.036, settings)


def test_a_readout_needs_an_exposure_time():
    check_readout(0.0, None)
    check_readout(0.02, 0.01)
    with pytest.raises(ConfigError, match=r"a readout of 0\.02 s .* --exposure, or --readout 0"):
        check_readout(0.02, None)


def test_a_region_is_inside():
    picture = SimpleNamespace(width=40, height=30)
    check_roi(None, picture)
    check_roi((0, 0, 40, 30), picture)
    for roi in [(1, 0, 40, 30), (0, 1, 40, 30), (0, 0, 0, 3), (-1, 0, 3, 3)]:
        with pytest.raises(ConfigError, match="is not inside the picture of 40x30 pixels"):
            check_roi(roi, picture)


def test_pictures_of_two_sizes_are_named():
    shot, empty = SimpleNamespace(width=4, height=3), SimpleNamespace(width=3, height=4)
    check_size(Path("a"), shot, Path("b"), shot)
    with pytest.raises(MismatchError, match="a has 4x3 pixels but the background b has 3x4"):
        check_size(Path("a"), shot, Path("b"), empty)
