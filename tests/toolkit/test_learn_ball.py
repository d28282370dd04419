import math
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from toolkit import load_shot
from toolkit.ball_file import read_ball, write_ball
from toolkit.camera_file import write_camera
from toolkit.errors import CalibrationError, ConfigError, ImageError, MismatchError
from toolkit.imaging import write_png16
from toolkit.learn_ball import Told, learn_ball
from toolkit.synthetic import LambertBall, benchmark_scene, render_sharp, render_shot

RADIUS = 0.05
FOCAL_STD = 0.002
"""Of the focal length, as a share."""
# in radii; each picture is 200 px about the ball
PLACES = [(0.1, -0.1, 15.0), (0.0, 0.2, 17.0), (0.1, 0.1, 20.0)]


def write(path: Path, light: torch.Tensor) -> Path:
    write_png16(path, light.double().numpy().clip(0, 1))
    return path


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    """A camera, an empty view, and a ball at three places in it; and another, larger ball."""
    folder = tmp_path_factory.mktemp("studio")
    scene = benchmark_scene(width_px=60, length_widths=1, distance_R=15, size=(200, 190))
    scene = replace(scene, appearance=LambertBall(colour=(0.67, 0.49, 0.11)))
    camera = replace(
        scene.camera,
        covariance=torch.diag(
            torch.tensor([FOCAL_STD * scene.camera.fx, FOCAL_STD * scene.camera.fx, 0.5, 0.5])
        ).double()
        ** 2,
    )
    camera = replace(camera, covariance=_together(camera.covariance))
    write_camera(folder / "camera.toml", camera)
    write_camera(folder / "bare.toml", scene.camera)
    write(folder / "bg.png", render_shot(scene, step=3.0, supersampling=1).background.rgb[0])
    for seed, place in enumerate(PLACES):
        position = tuple(RADIUS * x for x in place)
        write(
            folder / f"{seed}.png", render_sharp(scene, seed=seed, position=position).image.rgb[0]
        )
    larger = replace(scene, ball_radius=1.2 * RADIUS)
    position = tuple(RADIUS * x for x in PLACES[2])
    write(folder / "larger.png", render_sharp(larger, seed=7, position=position).image.rgb[0])
    (folder / "broken.png").write_bytes(b"no picture")
    return folder


def _together(covariance):
    """The same error of both focal lengths."""
    changed = covariance.clone()
    changed[0, 1] = changed[1, 0] = 0.999 * covariance[0, 0]
    return changed


def distances(*indices: int) -> tuple[float, ...]:
    return tuple(RADIUS * math.hypot(*PLACES[i]) for i in indices)


def learn(studio, names, told=None, camera="camera.toml", **more):
    images = [studio / f"{name}.png" for name in names]
    lens = None if camera is None else studio / camera
    told = Told() if told is None else told
    return learn_ball(images, [studio / "bg.png"], told=told, camera=lens, **more)


def test_radius_from_distances(studio):
    told = Told(distances=distances(0, 1, 2), distance_std=0.0005)
    found = learn(studio, "012", told)
    assert found.left_out == ()
    assert found.cautions == ()
    # two thousandths by the focal length, one by the distances, and what the rims err
    assert 0.002 * RADIUS < found.file.radius_std < 0.006 * RADIUS
    assert abs(found.file.radius - RADIUS) < 2 * found.file.radius_std
    one = learn(studio, "0", replace(told, distances=distances(0)))
    assert one.file.radius_std > found.file.radius_std * 0.8


def test_a_distance_that_nobody_vouches_for_is_taken_for_unsure(studio):
    found = learn(studio, "0", Told(distances=distances(0)))
    assert found.distance_std == 0.01
    assert found.file.radius_std == pytest.approx(0.01 / distances(0)[0] * RADIUS, rel=0.1)


def test_distance_from_the_radius(studio):
    found = learn(studio, "01", Told(radius=RADIUS, radius_std=0.0002))
    assert (found.file.radius, found.file.radius_std) == (RADIUS, 0.0002)
    assert found.radius is None
    for picture, true in zip(found.pictures, distances(0, 1), strict=True):
        away = RADIUS / picture.size.ratio
        assert abs(away - true) < 2 * away * picture.size.std


def test_without_either_there_is_a_scale_only(studio):
    found = learn(studio, "0")
    assert found.file.radius is None
    assert found.pictures[0].size.ratio == pytest.approx(RADIUS / distances(0)[0], rel=0.005)
    assert learn(studio, "0", camera=None).pictures[0].size is None


def test_a_radius_that_the_pictures_contradict_is_said(studio):
    told = Told(radius=1.05 * RADIUS, distances=distances(0, 1), distance_std=0.0005)
    found = learn(studio, "01", told)
    assert found.file.radius == 1.05 * RADIUS  # what is told is kept, and doubted
    assert "--radius says 52.50 mm and the pictures" in found.cautions[0]
    fine = learn(studio, "01", replace(told, radius=RADIUS))
    assert fine.cautions == ()


def test_a_lens_known_no_better_is_said(studio):
    found = learn(studio, "0", Told(distances=distances(0)), camera="bare.toml")
    assert "no covariance" in found.cautions[0]


def test_a_picture_that_contradicts_is_left_out(studio):
    told = Told(distances=distances(0, 1, 2), distance_std=0.0005)
    found = learn(studio, ["0", "1", "larger"], told)
    (left_out,) = found.left_out
    assert (left_out.path.name, left_out.of) == ("larger.png", "radius")
    assert "check its distance" in left_out.reason
    assert abs(found.file.radius - RADIUS) < 2 * found.file.radius_std
    with pytest.raises(CalibrationError, match="contradict each other"):
        learn(studio, ["0", "larger"], replace(told, distances=distances(0, 2)))


def test_pictures_without_a_ball_are_named_and_the_rest_is_used(studio):
    shutil.copy(studio / "0.png", studio / "twin.png")
    seen = []
    told = Told(distances=distances(0, 0, 0, 1, 0), distance_std=0.0005)
    names = ["bg", "0", "broken", "1", "twin"]
    found = learn(studio, names, told, on_picture=seen.append)
    assert [path.stem for path in seen] == names
    assert [(one.path.stem, one.of) for one in found.left_out] == [
        ("bg", "all"),
        ("broken", "all"),
        ("twin", "all"),
    ]
    reasons = [one.reason for one in found.left_out]
    assert "no ball found" in reasons[0]
    assert "broken.png" in reasons[1]
    assert "the same file as" in reasons[2]
    # each of the others kept its own distance
    assert [one.distance for one in found.pictures] == list(distances(0, 1))
    assert abs(found.file.radius - RADIUS) < 2 * found.file.radius_std


def test_no_picture_with_a_ball_is_refused(studio):
    with pytest.raises(CalibrationError, match="no ball found"):
        learn(studio, ["bg"])
    with pytest.raises(ImageError, match=r"none of 2 pictures can be used: .*broken\.png"):
        learn(studio, ["broken", "bg"])
    with pytest.raises(ImageError, match="does not exist"):
        learn_ball([studio / "0.png"], [studio / "none.png"], told=Told())


def test_another_size_is_left_out(studio, tmp_path):
    from toolkit import read_image

    light = read_image(studio / "2.png", response="linear").rgb[0]
    empty = read_image(studio / "bg.png", response="linear").rgb[0]
    cut = [write(tmp_path / n, x[:, :-4]) for n, x in (("c.png", light), ("e.png", empty))]
    found = learn_ball(
        [studio / "0.png", cut[0], studio / "1.png"],
        [studio / "bg.png", cut[1], studio / "bg.png"],
        told=Told(),
    )
    (left_out,) = found.left_out
    assert left_out.reason == "200x186 px, but most pictures are 200x190"


def test_one_background_each_or_all_for_all(studio):
    images = [studio / f"{i}.png" for i in (0, 1)]
    shutil.copy(studio / "bg.png", studio / "bg2.png")
    empty = (studio / "bg.png", studio / "bg2.png")
    each = learn_ball(images, empty, told=Told())
    assert [one.background for one in each.pictures] == [empty[:1], empty[1:]]
    both = learn_ball(images[:1], empty, told=Told())
    assert both.pictures[0].background == empty


def test_light_of_pictures_that_are_alike_is_averaged(studio, tmp_path):
    found = learn(studio, "012")
    names = [found.file.sharp.image.name, *(source.image.name for source in found.file.also)]
    assert sorted(names) == ["0.png", "1.png", "2.png"]
    assert found.reference.path == found.file.sharp.image
    write_ball(tmp_path / "ball.toml", found.file)
    again = read_ball(tmp_path / "ball.toml")
    assert again.colours_std == found.file.colours_std
    assert len(again.also) == 2


def test_other_light_is_left_out_of_the_shading(studio, tmp_path):
    from toolkit import read_image

    light, empty = (
        read_image(studio / name, response="linear").rgb[0] for name in ("0.png", "bg.png")
    )
    is_ball = (light - empty).abs().sum(0) > 0.15
    dim = write(tmp_path / "dim.png", torch.where(is_ball, 0.9 * light, light))
    images = [studio / "0.png", studio / "1.png", dim]
    found = learn_ball(images, [studio / "bg.png"], told=Told())
    assert {(one.path.name, one.of) for one in found.left_out} == {("dim.png", "colours")}
    assert dim not in {found.file.sharp.image, *(source.image for source in found.file.also)}
    two = learn_ball([studio / "0.png", dim], [studio / "bg.png"], told=Told())
    (left_out,) = two.left_out
    assert (left_out.of, two.file.also) == ("shading", ())
    assert "of the ball's brightness: lit or turned otherwise" in left_out.reason
    # of two nobody knows which is right: the spread tells
    assert two.file.colours_std[0][0] > 0.03 * two.file.colours[0][0]


@pytest.mark.parametrize(
    ("told", "camera", "reason"),
    [
        (Told(distances=(0.7,)), None, "give --camera"),
        (Told(distances=(0.7, 0.8, 0.9)), "camera.toml", "3 distances for 2 pictures"),
        (Told(distances=(-0.7,)), "camera.toml", "--distance is -0.7 m"),
        (Told(radius=math.nan), None, "--radius is nan m"),
        (Told(radius_std=0.01), None, "--radius-std is 0.01 m"),
        (Told(radius=0.03, radius_std=0.05), None, "--radius-std is 0.05 m"),
        (Told(distances=(0.7,), distance_std=0.0), "camera.toml", "--distance-std is 0 m"),
    ],
)
def test_impossible_numbers_are_refused_before_anything_is_read(tmp_path, told, camera, reason):
    lens = None if camera is None else tmp_path / camera
    images = [tmp_path / "a.png", tmp_path / "b.png"]
    with pytest.raises(ConfigError, match=reason) as caught:
        learn_ball(images, [tmp_path / "bg.png"], told=told, camera=lens)
    assert "\n" not in str(caught.value)


def test_a_camera_of_another_size_is_refused(studio, tmp_path):
    scene = benchmark_scene(width_px=60, length_widths=1, size=(210, 190))
    write_camera(tmp_path / "camera.toml", scene.camera)
    with pytest.raises(MismatchError, match="200x190"):
        learn_ball(
            [studio / "0.png"],
            [studio / "bg.png"],
            told=Told(),
            camera=tmp_path / "camera.toml",
        )


def test_measure_takes_the_radius_and_its_uncertainty(studio):
    told = Told(distances=distances(0, 1), distance_std=0.0005)
    found = learn(studio, "01", told)
    write_ball(studio / "ball.toml", found.file)
    named = {"camera": studio / "camera.toml", "background": [studio / "bg.png"]}
    shot = load_shot(studio / "0.png", ball=studio / "ball.toml", **named)
    assert (shot.ball_radius, shot.ball_radius_std) == (found.file.radius, found.file.radius_std)
    assert shot.provenance["ball_radius_std"] == "measured"
    own = load_shot(studio / "0.png", ball=studio / "ball.toml", ball_radius=0.04, **named)
    assert (own.ball_radius, own.ball_radius_std) == (0.04, 0.0)
    assert own.provenance["ball_radius_std"] == "assumed"
