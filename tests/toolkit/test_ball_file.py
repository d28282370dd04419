from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from toolkit import ConfigError, EnvironmentFault, ImageError, MismatchError
from toolkit.ball import Disc
from toolkit.ball_file import BallFile, SharpSource, read_ball, write_ball
from toolkit.ball_look import look_at_ball
from toolkit.imaging import write_png16
from toolkit.synthetic import LambertBall

DISC = Disc(centre=(30.25, 28.5), semi_axes=(20.5, 20.25), angle=0.5, std=0.02)


def full(folder: Path) -> BallFile:
    return BallFile(
        radius=0.036,
        kind="plane",
        colours=((0.7, 0.2, 0.1), (0.1, 0.2, 0.6)),
        plane_normal=(0.6, 0.0, 0.8),
        plane_normal_std=0.002,
        sharp=SharpSource(
            image=folder / "pictures/ball.png",
            background=(folder / "a.png", folder / "b.png"),
            disc=DISC,
            response="srgb",
        ),
    )


def test_what_is_written_is_read_again(tmp_path):
    write_ball(tmp_path / "ball.toml", full(tmp_path))
    assert read_ball(tmp_path / "ball.toml") == full(tmp_path)


def test_what_several_pictures_tell_is_kept(tmp_path):
    one = full(tmp_path)
    others = tuple(replace(one.sharp, image=tmp_path / f"{n}.png") for n in ("c", "d"))
    std = ((0.01, 0.02, 0.03), (0.001, 0.002, 0.003))
    ball = replace(one, radius_std=0.0002, colours_std=std, also=others)
    write_ball(tmp_path / "ball.toml", ball)
    again = read_ball(tmp_path / "ball.toml")
    assert again == ball
    names = [path.name for path in again.files]
    assert names == ["ball.png", "a.png", "b.png", "c.png", "d.png"]


def test_pictures_are_named_from_the_file(tmp_path):
    (tmp_path / "out").mkdir()
    write_ball(tmp_path / "out/ball.toml", full(tmp_path))
    assert 'image = "../pictures/ball.png"' in (tmp_path / "out/ball.toml").read_text()
    sharp = read_ball(tmp_path / "out/ball.toml").sharp
    assert sharp.image.resolve() == (tmp_path / "pictures/ball.png").resolve()


def test_response_file_is_kept_as_a_file(tmp_path):
    source = SharpSource(
        image=tmp_path / "i.png",
        background=(tmp_path / "b.png",),
        disc=DISC,
        response=tmp_path / "r.toml",
    )
    write_ball(tmp_path / "ball.toml", BallFile(sharp=source))
    again = read_ball(tmp_path / "ball.toml").sharp
    assert again == source
    assert again.files == (tmp_path / "i.png", tmp_path / "b.png", tmp_path / "r.toml")


def test_empty_file_says_nothing(tmp_path):
    write_ball(tmp_path / "ball.toml", BallFile())
    assert (tmp_path / "ball.toml").read_text() == 'schema = "toolkit.ball/1"\n'
    assert read_ball(tmp_path / "ball.toml") == BallFile()


SHARP = """
[sharp]
image = "i.png"
background = ["b.png"]
centre_px = [30, 28]
semi_axes_px = [20, 19]
angle_rad = 0.5
std_px = 0.1
"""


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("weight = 3", "unknown key 'weight'"),
        ("radius_m = -1", "radius_m is -1; a positive number"),
        ("radius_m = nan", "radius_m is nan"),
        ("radius_m = true", "'radius_m' is True"),
        ('kind = "cube"', "kind is 'cube'"),
        ("colours = [1]", "colour 1 is not three numbers"),
        ("colours = [[1, 2]]", "3 finite numbers are needed"),
        ("colours = [[1, 2, inf]]", "3 finite numbers are needed"),
        ("plane_normal = [1, 1, 1]", "plane_normal has the length 1.73"),
        ("plane_normal = [0, true, 1]", "3 finite numbers are needed"),
        ("plane_normal_std = 0", "plane_normal_std is 0"),
        ("radius_std_m = 0", "radius_std_m is 0"),
        ("colours = [[1, 2, 3]]\ncolours_std = []\nalso = []", "[[also]] without [sharp]"),
        ("colours = [[1, 2, 3]]\ncolours_std = [[1, 2, 3], [1, 2, 3]]", "one each"),
        ("colours_std = [[1, 2]]", "3 finite numbers are needed"),
        ("also = [3]\n" + SHARP, "[[also]] is 3"),
        (SHARP + SHARP.replace("[sharp]", "[[also]]").replace("28", "nan"), "[[also]]: centre_px"),
        (SHARP + "colour = 1", "unknown key 'colour'"),
        (SHARP.replace('image = "i.png"\n', ""), "image missing; run `toolkit ball` again"),
        (SHARP.replace('["b.png"]', "[]"), "a list of paths is needed"),
        (SHARP.replace('["b.png"]', "[3]"), "a list of paths is needed"),
        (SHARP.replace("[20, 19]", "[19, 20]"), "make no disc"),
        (SHARP.replace("[20, 19]", "[20, 0]"), "make no disc"),
        (SHARP.replace("[30, 28]", "[30]"), "2 finite numbers are needed"),
        (SHARP.replace("0.5", "nan"), "2 finite numbers are needed"),
        (SHARP + 'response = "srgb"\nresponse_file = "r.toml"', "both response and response_file"),
        ("radius_m = ", "is not valid TOML"),
    ],
)
def test_damaged_files_are_refused_in_one_line(tmp_path, text, reason):
    path = tmp_path / "ball.toml"
    path.write_text(f'schema = "toolkit.ball/1"\n{text}\n')
    with pytest.raises(ConfigError) as caught:
        read_ball(path)
    assert reason in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_other_schemas_and_missing_files_are_refused(tmp_path):
    path = tmp_path / "ball.toml"
    path.write_text('schema = "toolkit.rig/1"\n')
    with pytest.raises(ConfigError, match=r"toolkit\.ball/1"):
        read_ball(path)
    with pytest.raises(ConfigError, match="does not exist"):
        read_ball(tmp_path / "none.toml")


def test_nothing_is_half_written(tmp_path):
    with pytest.raises(ConfigError, match="radius_m"):
        write_ball(tmp_path / "ball.toml", BallFile(radius=float("nan")))
    with pytest.raises(EnvironmentFault):
        write_ball(tmp_path / "none/ball.toml", BallFile())
    assert list(tmp_path.iterdir()) == []


def test_looking_reads_the_pictures_again(sharp_ball, tmp_path):
    sharp, empty = sharp_ball(None)
    for name, picture in (("i", sharp.image), ("b", empty)):
        write_png16(tmp_path / f"{name}.png", picture.rgb[0].numpy().astype(np.float64).clip(0))
    found = look_at_ball(sharp.image, empty)
    source = SharpSource(
        image=tmp_path / "i.png", background=(tmp_path / "b.png",), disc=found.disc
    )
    write_ball(tmp_path / "ball.toml", BallFile(sharp=source))
    again = read_ball(tmp_path / "ball.toml").sharp.look()
    assert again.disc.centre == pytest.approx(found.disc.centre)
    assert torch.allclose(again.rgb, found.rgb, atol=5e-3)


def test_lost_or_exchanged_pictures_are_told(sharp_ball, tmp_path):
    source = SharpSource(image=tmp_path / "i.png", background=(tmp_path / "b.png",), disc=DISC)
    with pytest.raises(ImageError, match="does not exist"):
        source.look()
    for name in ("i", "b"):
        write_png16(tmp_path / f"{name}.png", np.linspace(0.1, 0.9, 3 * 900).reshape(3, 30, 30))
    with pytest.raises(MismatchError, match="is not inside"):
        source.look()


def test_looking_at_several_pictures_gives_their_mean(sharp_ball, tmp_path):
    sources = []
    for seed in (0, 1):
        sharp, empty = sharp_ball(matt, radius_px=15, seed=seed)
        names = [tmp_path / f"{kind}{seed}.png" for kind in ("i", "b")]
        for name, picture in zip(names, (sharp.image, empty), strict=True):
            write_png16(name, picture.rgb[0].numpy().astype(np.float64).clip(0))
        sources.append(
            SharpSource(image=names[0], background=(names[1],), disc=sharp.disc, response="linear")
        )
    write_ball(tmp_path / "ball.toml", BallFile(sharp=sources[0], also=(sources[1],)))
    found = read_ball(tmp_path / "ball.toml").look()
    alone = [source.look() for source in sources]
    assert torch.allclose(found.rgb, (alone[0].rgb + alone[1].rgb) / 2)
    assert found.disc == alone[0].disc
    with pytest.raises(ConfigError, match="names no sharp picture"):
        BallFile().look()


def matt(colour):
    return LambertBall(colour=(0.67, 0.49, 0.11))
