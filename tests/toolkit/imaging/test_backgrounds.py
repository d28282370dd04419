import av
import numpy as np
import pytest
import torch

from toolkit.errors import ConfigError, ImageError, MismatchError
from toolkit.imaging import read_background, read_image, write_dng, write_png16
from toolkit.imaging import video as video_module


@pytest.fixture
def scene(rng):
    return rng.uniform(0.1, 0.8, (3, 24, 30))


def write_clip(path, pictures):
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = "bgr0"
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))
    return path


def test_stills_are_averaged_in_linear_light(tmp_path, scene, rng):
    paths = []
    for number in range(4):
        paths.append(tmp_path / f"{number}.png")
        write_png16(paths[-1], scene + rng.normal(0, 0.02, scene.shape), exposure_s=0.01)
    background = read_background(paths)
    mean = torch.cat([read_image(path).rgb for path in paths]).mean(0)
    torch.testing.assert_close(background.rgb[0], mean, atol=1e-6, rtol=0)
    assert background.frames == 4
    assert background.exposure.tolist() == [0.01]
    assert read_background(paths[:1]).frames == 1


def test_mosaics_are_averaged_too(tmp_path, rng):
    mosaics = rng.integers(100, 4095, (3, 24, 30), dtype=np.uint16)
    mosaics[1, 4, 6] = 4095
    for number, values in enumerate(mosaics):
        write_dng(tmp_path / f"{number}.dng", values, white=4095)
    background = read_background([tmp_path / f"{n}.dng" for n in range(3)])
    np.testing.assert_allclose(background.mosaic[0, 0], mosaics.mean(0) / 4095, atol=1e-6)
    assert bool(background.clipped[0, 0, 4, 6])
    assert background.frames == 3


def test_stills_that_do_not_fit_together(tmp_path, scene, rng):
    first, second = tmp_path / "a.png", tmp_path / "b.png"
    write_png16(first, scene, exposure_s=0.01)
    write_png16(second, scene[:, :20], exposure_s=0.01)
    with pytest.raises(MismatchError, match=r"30 x 24 pixels, .*b\.png 30 x 20"):
        read_background([first, second])
    write_png16(second, scene, exposure_s=0.02)
    with pytest.raises(MismatchError, match=r"0\.01 s and 0\.02 s"):
        read_background([first, second])
    write_dng(tmp_path / "c.dng", rng.integers(0, 999, (24, 30), dtype=np.uint16), white=999)
    with pytest.raises(MismatchError, match="different kinds"):
        read_background([first, tmp_path / "c.dng"])


def test_the_median_of_a_clip_does_not_see_a_passing_ball(tmp_path, rng):
    scene = rng.integers(20, 200, (40, 60, 3), dtype=np.uint8)
    pictures = [scene.copy() for _ in range(11)]
    for number, picture in enumerate(pictures):
        picture[15:25, 5 * number : 5 * number + 8] = 255
    path = write_clip(tmp_path / "a.mkv", pictures)
    background = read_background([path], response="linear")
    np.testing.assert_allclose(background.rgb[0], scene.transpose(2, 0, 1) / 255, atol=1e-6)
    assert background.clipped.sum() == 0
    assert background.frames == round(2 * 11 / np.pi)
    assert read_background([path]).response_is_assumed


@pytest.mark.parametrize("count", [1, 2, 4, 7])
def test_the_median_of_noise(tmp_path, rng, count):
    pictures = list(rng.integers(0, 256, (count, 12, 14, 3), dtype=np.uint8))
    background = read_background([write_clip(tmp_path / "a.mkv", pictures)], response="linear")
    used = count - 1 + count % 2
    expected = np.median(pictures[:used], axis=0).transpose(2, 0, 1) / 255
    np.testing.assert_allclose(background.rgb[0], expected, atol=1e-6)
    assert background.frames == max(1, round(2 * used / np.pi))


def test_a_long_clip_is_sampled_evenly(tmp_path, rng, monkeypatch):
    monkeypatch.setattr(video_module, "MOST_MEDIAN_FRAMES", 5)
    pictures = list(rng.integers(0, 256, (41, 12, 14, 3), dtype=np.uint8))
    background = read_background([write_clip(tmp_path / "a.mkv", pictures)], response="linear")
    expected = np.median(pictures[::10], axis=0).transpose(2, 0, 1) / 255
    np.testing.assert_allclose(background.rgb[0], expected, atol=1e-6)
    assert background.frames == 3


def test_the_memory_of_a_clip_is_bounded(tmp_path, rng, monkeypatch):
    monkeypatch.setattr(video_module, "MOST_MEDIAN_BYTES", 3 * 12 * 14 * 3)
    monkeypatch.setattr(video_module, "MEDIAN_BAND_BYTES", 200)
    pictures = list(rng.integers(0, 256, (21, 12, 14, 3), dtype=np.uint8))
    background = read_background([write_clip(tmp_path / "a.mkv", pictures)], response="linear")
    expected = np.median([pictures[0], pictures[10], pictures[20]], axis=0)
    np.testing.assert_allclose(background.rgb[0], expected.transpose(2, 0, 1) / 255, atol=1e-6)


def test_impossible_backgrounds(tmp_path, scene):
    with pytest.raises(ConfigError, match="no background"):
        read_background([])
    path = tmp_path / "flat.png"
    write_png16(path, np.full((3, 8, 8), 0.5))
    with pytest.raises(ImageError, match=r"flat\.png is the same everywhere"):
        read_background([path])
    write_png16(path, scene)
    clip = write_clip(tmp_path / "a.mkv", [np.zeros((8, 8, 3), np.uint8)] * 3)
    with pytest.raises(ConfigError, match=r"a\.mkv is a video among several"):
        read_background([path, clip])
    with pytest.raises(ImageError, match="same everywhere"):
        read_background([clip])
    with pytest.raises(ImageError, match="does not exist"):
        read_background([tmp_path / "no.png"])


@pytest.mark.shared_data
def test_the_median_of_a_real_clip(shared):
    background = read_background([shared / "streaks/circle.avi"], response="linear")
    frames = [
        read_image(shared / "streaks/circle.avi", frame=n, response="linear").rgb
        for n in (0, 60, 120)
    ]
    # The ball and the arm are in each frame, but in few of the pixels.
    for frame in frames:
        assert float((frame - background.rgb).abs().median()) < 3 / 255
    assert background.frames == round(2 * 61 / np.pi)
