from pathlib import Path

import pytest

from toolkit import ConfigError
from toolkit.rig import Rig, read_rig

FULL = """
schema = "toolkit.rig/1"
[camera]
file = "lens/camera.toml"
[response]
file = "response.toml"
[ball]
radius_m = 0.036
radius_std_m = 0.0002
colours = [[0.5, 0.6, 1], [0.1, 0.1, 0.1]]
[exposure]
time_s = 0.01
time_std_s = 1e-5
readout_s = 0.02
[background]
images = ["empty.png", "bg/*.png"]
[measure]
estimator = "uniform"
colour = [0.5, 0.25, 1]
careful = true
steps = 3
label = "a"
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "rig.toml"
    path.write_text(text)
    return path


def test_every_key_is_read_and_paths_start_at_the_rig(tmp_path):
    (tmp_path / "bg").mkdir()
    for name in ("b.png", "a.png", "c.txt"):
        (tmp_path / "bg" / name).touch()
    assert read_rig(write(tmp_path, FULL)) == Rig(
        camera=tmp_path / "lens/camera.toml",
        response=tmp_path / "response.toml",
        ball_radius=0.036,
        ball_radius_std=0.0002,
        ball_colours=((0.5, 0.6, 1.0), (0.1, 0.1, 0.1)),
        exposure=0.01,
        exposure_std=1e-5,
        readout=0.02,
        background=(tmp_path / "empty.png", tmp_path / "bg/a.png", tmp_path / "bg/b.png"),
        estimator="uniform",
        options={"colour": "0.5,0.25,1", "careful": "true", "steps": "3", "label": "a"},
    )


def test_empty_rig_says_nothing(tmp_path):
    assert read_rig(write(tmp_path, 'schema = "toolkit.rig/1"')) == Rig()


def test_absolute_paths_stay(tmp_path):
    rig = write(tmp_path, 'schema = "toolkit.rig/1"\n[camera]\nfile = "/c.toml"')
    assert read_rig(rig).camera == Path("/c.toml")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[lens]", "unknown key 'lens'; known are camera, response, ball"),
        ("[ball]\nradius = 1", r"\[ball\]: unknown key 'radius'; known are radius_m"),
        ("[ball]\nradius_m = true", "'radius_m' is True; a float is needed"),
        ("[ball]\nradius_m = '1'", "'radius_m' is '1'; a float is needed"),
        ("[ball]\ncolours = [1, 2, 3]", "colour 1 is not three numbers"),
        ("[ball]\ncolours = [[1, 2]]", r"colour \[1, 2\] is not three numbers"),
        ("[ball]\ncolours = [[1, 2, '3']]", "is not three numbers"),
        ("[background]\nimages = [3]", "image 3 is not a path"),
        ("[background]\nimages = ['none/*.png']", r"no picture matches 'none/\*.png'"),
        ("[response]\nkind = 'srgb'\nfile = 'r.toml'", "both kind and file"),
        ("[exposure]\nreadout_s = 'fast'", "'readout_s' is 'fast'; a float is needed"),
        ("[measure]\nestimator = 3", "'estimator' is 3; a str is needed"),
        ("[measure]\nmap = {a = 1}", "'map' is {'a': 1}; a number, text or list is needed"),
        ("camera = 'c.toml'", "'camera' is 'c.toml'; a dict is needed"),
    ],
)
def test_mistake_is_named(tmp_path, text, reason):
    with pytest.raises(ConfigError, match=reason):
        read_rig(write(tmp_path, f'schema = "toolkit.rig/1"\n{text}'))


def test_flags_beat_the_rig():
    rig = Rig(camera=Path("a"), response="srgb", background=(Path("b"),), exposure=1.0)
    flags = Rig(response="linear", exposure=2.0)
    both = flags.over(rig)
    assert (both.camera, both.response, both.exposure) == (Path("a"), "linear", 2.0)
    assert both.background == (Path("b"),)
    assert Rig(readout=0.0).over(Rig(readout=0.02)).readout == 0
    assert flags.over(Rig(readout=0.02, exposure=1.0)).readout == 0.02


def test_standard_deviation_stays_with_its_own_value():
    rig = Rig(ball_radius=1.0, ball_radius_std=0.1, exposure=1.0, exposure_std=0.1)
    both = Rig(ball_radius=2.0, exposure=2.0).over(rig)
    assert both.ball_radius_std is both.exposure_std is None
    assert Rig(ball_radius_std=0.3).over(rig).ball_radius == 1.0
    assert Rig().over(rig) == rig


def test_options_stay_with_their_own_estimator():
    rig = Rig(estimator="a", options={"x": "1", "y": "1"})
    assert Rig(options={"y": "2"}).over(rig).options == {"x": "1", "y": "2"}
    assert Rig(estimator="a").over(rig).options == rig.options
    assert Rig(estimator="b", options={"z": "3"}).over(rig).options == {"z": "3"}


def test_ball_file_is_read_and_stays_beside_a_picture(tmp_path):
    text = 'schema = "toolkit.rig/1"\n[ball]\nfile = "balls/ball.toml"\n'
    rig = read_rig(write(tmp_path, text))
    assert rig.ball == tmp_path / "balls/ball.toml"
    assert Rig().over(rig).ball == rig.ball
    assert Rig(ball=Path("other.toml")).over(rig).ball == Path("other.toml")
    shown = Rig(ball_image=Path("sharp.png")).over(rig)
    assert (shown.ball, shown.ball_image) == (rig.ball, Path("sharp.png"))
