import av
import numpy as np
import pytest
from av.video.reformatter import Colorspace

from toolkit.errors import ConfigError, ImageError
from toolkit.imaging import read_image

SIZE = (64, 96)


def level(number):
    return 20 + 9 * number


def write_clip(path, codec="libx264", pixels="yuv444p", *, count=20, options=None, hd=False):
    """Write a clip whose left half tells the frame's number."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25, options=options or {})
        stream.width, stream.height, stream.pix_fmt = SIZE[1], SIZE[0], pixels
        if hd:
            stream.codec_context.colorspace = Colorspace.ITU709.value
        for number in range(count):
            picture = np.full((*SIZE, 3), (200, 60, 30), np.uint8)
            picture[:, : SIZE[1] // 2] = level(number)
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            if hd:
                frame = frame.reformat(format=pixels, dst_colorspace=Colorspace.ITU709)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def seen(path, number):
    rgb = read_image(path, frame=number, response="linear").rgb[0]
    return (255 * rgb[:, SIZE[0] // 2, [10, -10]]).T.numpy()


@pytest.mark.parametrize(
    ("name", "codec", "pixels", "options"),
    [
        ("b_frames.mp4", "libx264", "yuv420p", {"bf": "3", "g": "10", "qp": "8"}),
        ("key_frames.mp4", "libx264", "yuv444p", {"g": "1", "qp": "4"}),
        ("plain.avi", "mpeg4", "yuv420p", {"b": "4000000"}),
        ("lossless.mkv", "ffv1", "yuv444p", {}),
        ("b_frames.avi", "mpeg4", "yuv420p", {"bf": "2", "b": "4000000"}),
    ],
)
def test_every_frame_is_found_by_its_number(tmp_path, name, codec, pixels, options):
    path = write_clip(tmp_path / name, codec, pixels, options=options)
    for number in (0, 1, 7, 13, 19):
        assert seen(path, number)[0] == pytest.approx([level(number)] * 3, abs=4)


def test_a_frame_beyond_the_end_names_their_number(tmp_path):
    path = write_clip(tmp_path / "a.mp4", count=6)
    for number in (6, 600):
        with pytest.raises(ConfigError, match=r"has 6 frames; give --frame a number from 0 to 5"):
            read_image(path, frame=number)
    with pytest.raises(ConfigError, match="negative"):
        read_image(path, frame=-1)
    with pytest.raises(ConfigError, match="is a video; name the frame"):
        read_image(path)


def test_a_clip_is_taken_for_srgb_and_tells_no_exposure(tmp_path):
    image = read_image(write_clip(tmp_path / "a.mp4", count=3), frame=1)
    assert (image.response, image.response_is_assumed) == ("srgb", True)
    assert image.exposure is None
    assert image.clipped.sum() == 0


def test_the_colour_matrix_of_the_clip_is_used(tmp_path):
    options = {"qp": "1"}
    for hd in (False, True):
        path = write_clip(tmp_path / "a.mp4", options=options, hd=hd)
        assert seen(path, 3)[1] == pytest.approx([200, 60, 30], abs=4)


def test_ten_bits_keep_their_depth(tmp_path):
    path = write_clip(tmp_path / "a.mkv", "ffv1", "yuv444p10le")
    image = read_image(path, frame=3)
    assert (image.response, image.response_is_assumed) == ("srgb", True)
    values = seen(path, 3)[0]
    assert values == pytest.approx([level(3)] * 3, abs=1)
    assert abs(values - values.round()).max() > 0.01  # between the levels of eight bits


def test_interlaced_clips_are_refused(tmp_path):
    path = write_clip(tmp_path / "a.mp4", "mpeg2video", "yuv420p", options={"flags": "+ildct+ilme"})
    with pytest.raises(ImageError, match="interlaced"):
        read_image(path, frame=3)


@pytest.mark.parametrize(
    ("name", "codec"), [("a.mp4", "libx264"), ("a.avi", "mpeg4"), ("a.mkv", "ffv1")]
)
def test_a_cut_clip_gives_whole_frames_or_none(tmp_path, rng, capfd, name, codec):
    path = write_clip(tmp_path / name, codec, "yuv420p", options={"g": "5"})
    data = path.read_bytes()
    whole = {n: seen(path, n) for n in (0, 12, 19)}
    cut = tmp_path / f"cut_{name}"
    texts = []
    for _ in range(12):
        cut.write_bytes(data[: int(rng.integers(40, len(data)))])
        for number, expected in whole.items():
            try:
                found = seen(cut, number)
            except (ImageError, ConfigError) as error:
                texts.append(str(error))
            else:
                assert np.array_equal(found, expected)
    assert texts
    assert not any("\n" in text for text in texts)
    assert capfd.readouterr() == ("", "")


def test_sound_alone_is_no_video(tmp_path):
    path = tmp_path / "sound.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        frame = av.AudioFrame.from_ndarray(
            np.zeros((1, 800), np.int16), format="s16", layout="mono"
        )
        frame.sample_rate = 8000
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    with pytest.raises(ImageError, match="holds no video"):
        read_image(path, frame=0)


@pytest.mark.shared_data
def test_a_real_clip_by_number_and_one_by_one(shared):
    path = shared / "streaks/circle.avi"
    with av.open(str(path)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    for number in (0, 57, 120):
        image = read_image(path, frame=number, response="linear")
        expected = frames[number].transpose(2, 0, 1) / 255
        np.testing.assert_allclose(image.rgb[0], expected, atol=1e-6)
    with pytest.raises(ConfigError, match="has 121 frames"):
        read_image(path, frame=121)
