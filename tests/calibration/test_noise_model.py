import numpy as np
import pytest

from calibration.noise_model import measure_noise
from toolkit.errors import CalibrationError, ConfigError, MismatchError
from toolkit.imaging import write_dng

READ, GAIN = 0.002, 2e-4
WHITE = 16383


@pytest.fixture
def raws(tmp_path):
    """Write pairs of RAW photos of a ramp with noise of known size; other times, other light."""

    def write(times=(0.01, 0.01, 0.1, 0.1), *, flicker=0.0, seed=0, size=240):
        rng = np.random.default_rng(seed)
        ramp = np.linspace(0.1, 8, size) * np.ones((size, 1))
        paths = []
        for index, time in enumerate(times):
            light = ramp * time * (1 + flicker * index)
            noisy = light + rng.normal(size=light.shape) * np.sqrt(READ**2 + GAIN * light)
            stored = np.clip(np.rint(256 + noisy * (WHITE - 256)), 0, WHITE).astype(np.uint16)
            paths.append(tmp_path / f"flat{index}.dng")
            write_dng(paths[-1], stored, black=256, white=WHITE, exposure_s=time)
        return paths

    return write


def test_read_noise_and_gain_come_back_within_their_deviation(raws):
    found = measure_noise(raws())
    assert found.photos == 4
    assert found.warnings == ()
    for channel in range(3):
        assert found.read_std[channel] == pytest.approx(READ, abs=4 * found.read_std_error[channel])
        assert found.gain[channel] == pytest.approx(GAIN, abs=4 * found.gain_std[channel])
        assert found.gain_std[channel] < 0.06 * GAIN
        assert found.read_std_error[channel] < 0.15 * READ
    np.testing.assert_allclose(found.model.gain[0], found.gain, rtol=1e-6)


def test_flicker_is_taken_out_and_told(raws):
    found = measure_noise(raws((0.05,) * 3, flicker=0.05))
    assert found.gain[1] == pytest.approx(GAIN, rel=0.15)
    assert "light-changed" in {caution.code for caution in found.warnings}


def test_what_cannot_tell_noise_is_refused(raws, tmp_path):
    paths = raws((0.01, 0.1))
    with pytest.raises(CalibrationError, match="no two photos were exposed equally long"):
        measure_noise(paths)
    with pytest.raises(ConfigError, match="named twice"):
        measure_noise([paths[0], paths[0]])
    with pytest.raises(CalibrationError, match="nearly all is clipped"):
        measure_noise(raws((2.0, 2.0)))
    small = raws((0.1,), size=100)
    write_dng(
        tmp_path / "wide.dng", np.arange(12000, dtype=np.uint16).reshape(100, 120), exposure_s=0.1
    )
    with pytest.raises(MismatchError, match=r"flat0\.dng and .*wide\.dng differ in size or kind"):
        measure_noise([*small, tmp_path / "wide.dng"])


def test_photos_between_which_something_moved_are_refused(raws):
    first, second = raws((0.1, 0.1))
    rng = np.random.default_rng(5)
    light = np.linspace(0.1, 8, 240) * np.ones((240, 1)) * 0.1
    light[60:120, 60:120] *= 0.7  # 6 % of the picture
    noisy = light + rng.normal(size=light.shape) * np.sqrt(READ**2 + GAIN * light)
    stored = np.clip(np.rint(256 + noisy * (WHITE - 256)), 0, WHITE).astype(np.uint16)
    write_dng(second, stored, black=256, white=WHITE, exposure_s=0.1)
    with pytest.raises(MismatchError, match="differ by more than noise in"):
        measure_noise([first, second])
