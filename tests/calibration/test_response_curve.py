from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration import brackets
from calibration.brackets import check_bracket, read_bracket
from calibration.response_curve import fit_channel, measure_response
from toolkit.errors import CalibrationError, ConfigError, ImageError, MismatchError
from toolkit.imaging import write_dng, write_png16
from toolkit.response import load_response, write_response

MEMORIAL = Path(__file__).resolve().parents[2].parent / "shared/data/brackets/memorial"
TIMES = tuple(2.0 ** np.arange(-3, 4))
SHAPE = (120, 160)


def scene(seed=0):
    """Light of a smooth scene over ten stops [3, H, W]."""
    rng = np.random.default_rng(seed)
    rough = rng.normal(size=(3, 6, 8))
    smooth = np.stack([cv2.resize(r, SHAPE[::-1], interpolation=cv2.INTER_CUBIC) for r in rough])
    return 2 ** (2.7 * (smooth - smooth.mean()) / smooth.std() - 3)


def photograph(folder, *, times=TIMES, light=None, gamma=2.2, seed=0, shift=0, is_grey=True):
    rng = np.random.default_rng(seed)
    light = scene() if light is None else light
    paths = []
    for index, time in enumerate(times):
        seen = np.roll(light, shift * (index % 2), axis=2)
        stored = np.clip(np.minimum(seen * time, 1) ** (1 / gamma), 0, 1)
        noisy = stored + rng.normal(0, 1 / 255, stored.shape)
        picture = np.clip(np.rint(255 * noisy), 0, 255).astype(np.uint8).transpose(1, 2, 0)
        paths.append(folder / f"photo{index}.png")
        cv2.imwrite(str(paths[-1]), picture[..., 1] if is_grey else picture[..., ::-1])
    return paths


def worst(result, gamma=2.2):
    off = 0.0
    for curve in result.curves:
        b, found = curve.brightness[12:244], curve.exposure[12:244]
        true = b**gamma
        factor = (found * true).sum() / (found * found).sum()
        off = max(off, float(np.sqrt(np.mean((factor * found - true) ** 2))))
    return off


def test_a_bracket_in_any_order_gives_the_curve_of_each_channel(tmp_path):
    paths = photograph(tmp_path, is_grey=False)
    seen = []
    result = measure_response(paths[::-1], TIMES[::-1], on_photo=seen.append)
    assert seen == paths[::-1]
    assert result.bracket.paths == tuple(paths)
    assert worst(result) < 1e-3
    assert result.warnings == ()
    assert np.abs(result.time_errors[1:-1]).max() < 0.01
    assert max(channel.residual for channel in result.channels) < 0.1
    write_response(tmp_path / "response.toml", result.curves, {})
    assert load_response(tmp_path / "response.toml").curves is not None


def test_a_camera_that_moved_by_a_pixel_hardly_matters(tmp_path):
    assert worst(measure_response(photograph(tmp_path, shift=1), TIMES)) < 5e-3


def test_a_border_and_a_stranger_in_one_photo_hardly_matter(tmp_path):
    paths = photograph(tmp_path, is_grey=False)
    picture = cv2.imread(str(paths[3]))
    picture[:, :12], picture[40:70, 50:90] = (200, 30, 120), (60, 200, 90)
    cv2.imwrite(str(paths[3]), picture)
    assert worst(measure_response(paths, TIMES)) < 2e-3


def test_a_damaged_photo_is_left_out_and_named(tmp_path):
    paths = photograph(tmp_path)
    paths[2].write_bytes(paths[2].read_bytes()[:500])
    result = measure_response(paths, TIMES)
    assert [caution.code for caution in result.warnings] == ["photo-left-out"]
    assert "photo2.png" in result.warnings[0].message
    assert len(result.bracket.times) == 6
    assert worst(result) < 2e-3


def test_times_come_from_the_files_and_deep_grey_raw_is_linear(tmp_path):
    light = cv2.resize(scene()[0], (480, 360))
    paths = []
    rng = np.random.default_rng(1)
    for index, time in enumerate(TIMES):
        paths.append(tmp_path / f"raw{index}.dng")
        seen = np.clip(light * time + rng.normal(0, 1e-3, light.shape), 0, 1)
        mosaic = np.rint(seen * 4095).astype(np.uint16)
        write_dng(paths[-1], mosaic, white=4095, exposure_s=time)
    result = measure_response(paths)
    assert result.bracket.is_raw
    assert result.bracket.times == pytest.approx(TIMES)
    assert result.bend < 0.01
    assert result.is_linear
    assert min(channel.linear_up_to for channel in result.channels) > 0.85


def test_a_sensor_that_bends_near_white_is_told(tmp_path):
    light = cv2.resize(scene()[0], (480, 360))
    rng = np.random.default_rng(1)
    paths = []
    for index, time in enumerate(TIMES):
        paths.append(tmp_path / f"raw{index}.dng")
        seen = np.clip(light * time, 0, 1.3)
        bent = seen - 0.5 * np.maximum(seen - 0.6, 0) ** 2  # half as steep near white
        stored = np.rint(4095 * np.clip(bent + rng.normal(0, 1e-3, light.shape), 0, 0.95) / 0.95)
        write_dng(paths[-1], stored.astype(np.uint16), white=4095, exposure_s=time)
    result = measure_response(paths)
    assert not result.is_linear
    for channel in result.channels:
        assert channel.linear_up_to == pytest.approx(0.71 / 0.95, abs=0.04)


def test_a_shutter_marked_in_rounded_times_is_understood(tmp_path):
    light = scene() * 8
    paths = photograph(tmp_path, times=2.0 ** np.arange(-6, 1), light=light)
    marked = [1 / 60, 1 / 30, 1 / 15, 1 / 8, 1 / 4, 1 / 2, 1.0]
    result = measure_response(paths, marked)
    assert [caution.code for caution in result.warnings] == ["times-rounded"]
    assert result.bracket.times == pytest.approx(2.0 ** np.arange(-6, 1))
    assert worst(result) < 1e-3
    # and one that keeps such times is believed
    result = measure_response(photograph(tmp_path, times=marked, light=light), marked)
    assert result.warnings == ()
    assert result.bracket.times == pytest.approx(marked)
    assert worst(result) < 1e-3


@pytest.mark.parametrize(
    ("times", "text", "error"),
    [
        (TIMES[:4], "4 values for 7 photos", ConfigError),
        ((*TIMES[:-1], -1.0), "-1 is no exposure time", ConfigError),
        ((0.5,) * 7, "all photos were exposed equally long", CalibrationError),
        (TIMES[::-1], "darker", MismatchError),
        ((*TIMES[:3], 1.6, *TIMES[4:]), "photo3.png states 1.6 s but looks like", MismatchError),
        (None, "photo0.png states no exposure time", ConfigError),
    ],
)
def test_times_that_cannot_be(tmp_path, times, text, error):
    with pytest.raises(error, match=text):
        measure_response(photograph(tmp_path), times)


def test_a_photo_that_is_as_bright_for_twice_the_time(tmp_path):
    paths = photograph(tmp_path)
    paths[4].write_bytes(paths[3].read_bytes())
    with pytest.raises(MismatchError, match=r"photo4.png \(2 s\) is as bright as photo3.png"):
        measure_response(paths, TIMES)


def test_another_scene_is_named(tmp_path):
    paths = photograph(tmp_path)
    (tmp_path / "other").mkdir()
    other = photograph(tmp_path / "other", light=scene(5))
    with pytest.raises(MismatchError, match=r"photo3\.png"):
        measure_response([*paths[:3], other[3], *paths[4:]], TIMES)


def test_clipped_few_and_unlike_photos(tmp_path):
    with pytest.raises(CalibrationError, match="add shorter exposures"):
        measure_response(photograph(tmp_path, times=TIMES, light=scene() * 2e5), TIMES)
    with pytest.raises(CalibrationError, match="add longer exposures"):
        measure_response(photograph(tmp_path, times=TIMES, light=scene() * 1e-6), TIMES)
    paths = photograph(tmp_path)
    with pytest.raises(CalibrationError, match="one photo tells nothing"):
        measure_response(paths[:1], TIMES[:1])
    (tmp_path / "far").mkdir()
    far = photograph(tmp_path / "far", times=(0.02, 1.0))
    with pytest.raises(CalibrationError, match=r"not determined.*add"):
        measure_response(far, (0.02, 1.0))
    write_png16(paths[1], np.full((3, 90, 160), 0.5, np.float32))
    with pytest.raises(MismatchError, match=r"photo1.png has 160x90 px"):
        measure_response(paths, TIMES)
    paths[0].write_text("no picture")
    paths[1].unlink()
    with pytest.raises(ImageError, match=r"fewer than two photos.*photo0.*photo1"):
        measure_response(paths[:2], TIMES[:2])
    with pytest.raises(ConfigError, match="named twice"):
        measure_response([paths[2], paths[2]], TIMES[:2])


@pytest.mark.shared_data
def test_the_memorial_church(monkeypatch):
    if not MEMORIAL.is_dir():
        pytest.skip("the bracket of the memorial church is not beside the project")
    monkeypatch.setattr(brackets, "POSITIONS", 20_000)
    rows = [line.split() for line in (MEMORIAL / "memorial.txt").read_text().splitlines()]
    bracket = read_bracket([MEMORIAL / row[0] for row in rows], [1 / float(row[1]) for row in rows])
    check_bracket(bracket)
    red = fit_channel(bracket, 0)
    assert red.residual < 0.10
    assert np.nanmax(np.abs(red.time_errors)) < 0.10
