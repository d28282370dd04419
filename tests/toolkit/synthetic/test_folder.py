import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from toolkit.ball_file import read_ball
from toolkit.camera_file import read_camera
from toolkit.errors import ConfigError, EnvironmentFault
from toolkit.imaging import read_image
from toolkit.rig import read_rig
from toolkit.synthetic import (
    PRESETS,
    board_poses,
    mean_colour,
    pigments,
    preset_scene,
    render_board,
    render_sharp,
    render_shot,
)
from toolkit.synthetic.folder import bayer_values, write_shot

SIZE = (300, 200)
SHOT = render_shot(preset_scene("parabola", size=SIZE, seed=2))


def test_a_dng_gives_back_the_light_at_every_sensor_pixel(tmp_path):
    write_shot(tmp_path, SHOT)
    read = read_image(tmp_path / "shot.dng")
    mosaic, rgb = read.mosaic[0, 0], SHOT.image.rgb[0]
    step = 1 / (15871 - 512)
    for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        assert read.pattern[row][column] == channel
        difference = mosaic[row::2, column::2] - rgb[channel, row::2, column::2]
        assert difference.abs().max() <= 0.51 * step
    assert read.rgb.shape == (1, 3, 200, 300)
    assert read.exposure.tolist() == pytest.approx([0.25])


def test_a_png_gives_back_the_light(tmp_path):
    write_shot(tmp_path, SHOT, format="png")
    read = read_image(tmp_path / "background.png")
    difference = read.rgb - SHOT.background.rgb.clamp(0, 1)
    assert difference.abs().max() <= 0.51 / 65535
    assert read.exposure.tolist() == pytest.approx([0.25])
    assert read.response == "linear"


def test_stored_values_stay_between_zero_and_white():
    light = np.array([[[-1.0, 5.0]], [[0.0, 0.0]], [[0.0, 0.0]]], dtype=np.float32)
    assert bayer_values(np.repeat(light, 2, axis=1)).tolist() == [[0, 512], [512, 512]]
    assert bayer_values(np.full((3, 2, 2), 2, dtype=np.float32)).max() == 15871


def test_rig_camera_and_truth_agree_with_the_scene(tmp_path):
    write_shot(tmp_path, SHOT, seed=2)
    rig, scene = read_rig(tmp_path / "rig.toml"), SHOT.scene
    camera = read_camera(rig.camera)
    assert camera.parameters.tolist() == scene.camera.parameters.tolist()
    assert camera.covariance.count_nonzero() == 0  # the true camera is known exactly
    assert rig.ball_colours == (scene.appearance.colour,)
    assert (rig.ball_radius, rig.exposure) == (scene.ball_radius, scene.exposure)
    assert rig.background == (tmp_path / "background.dng",)
    assert (rig.estimator, rig.response) == ("uniform", "linear")
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["schema"] == "toolkit.truth/1"
    assert truth["position_m"] == SHOT.position.tolist()
    assert truth["speed_m_s"] == pytest.approx(SHOT.velocity.norm().item())
    assert truth["path"]["kind"] == "ParabolicPath"
    assert truth["path"]["start"] == list(scene.path.start)
    assert truth["noise"] == {"read": 0.01, "gain": 0.0}
    middle = truth["trajectory"]["position_m"][50]
    assert middle == pytest.approx(truth["position_m"])
    assert truth["camera"]["distortion"] == list(scene.camera.distortion)


def test_a_readout_is_told_and_moves_the_true_state_to_the_balls_own_row(tmp_path):
    scene = replace(SHOT.scene, readout=0.03)
    write_shot(tmp_path, render_shot(scene))
    assert read_rig(tmp_path / "rig.toml").readout == 0.03
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["readout_s"] == 0.03
    time = torch.tensor([truth["time_s"]], dtype=torch.float64)
    position = scene.path.position(time)
    assert truth["position_m"] == position[0].tolist()
    row = float(scene.camera.project(position)[0, 1])
    delay = 0.03 / (scene.camera.height - 1)
    assert truth["time_s"] == pytest.approx(row * delay + scene.exposure / 2, abs=1e-12)


def test_boards_come_in_place_of_the_camera_file(tmp_path):
    poses = board_poses(2, SHOT.scene.camera, (9, 6), 0.025)
    boards = (render_board(SHOT.scene.camera, (9, 6), 0.025, pose) for pose in poses)
    write_shot(tmp_path, SHOT, boards=boards)
    assert not (tmp_path / "camera.toml").exists()
    assert read_rig(tmp_path / "rig.toml").camera == tmp_path / "camera.toml"
    names = sorted(path.name for path in (tmp_path / "boards").iterdir())
    assert names == ["board_00.dng", "board_01.dng"]
    assert read_image(tmp_path / "boards" / "board_01.dng").rgb.shape == (1, 3, 200, 300)


def test_a_new_simulation_replaces_the_old_one_and_nothing_else(tmp_path):
    write_shot(tmp_path, SHOT)
    (tmp_path / "shot.json").write_text("a measurement")
    write_shot(tmp_path, SHOT, format="png", boards=[])
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {
        "shot.png", "background.png", "rig.toml", "truth.json", "boards", "shot.json"
    }  # fmt: skip


@pytest.mark.parametrize("truth", [None, "{}", "[1]", "no json"])
def test_a_folder_with_other_files_is_left_alone(tmp_path, truth):
    (tmp_path / "camera.toml").write_text("precious")
    if truth is not None:
        (tmp_path / "truth.json").write_text(truth)
    with pytest.raises(ConfigError, match="no simulation; name a new or empty folder"):
        write_shot(tmp_path, SHOT)
    assert (tmp_path / "camera.toml").read_text() == "precious"


def test_a_file_in_the_folder_s_place_is_an_environment_fault(tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(EnvironmentFault, match="taken cannot be made"):
        write_shot(tmp_path / "taken", SHOT)


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_keeps_its_ball_in_the_picture_with_contrast(name):
    scene = preset_scene(name, size=SIZE)
    shot = render_shot(scene, step=1.0, supersampling=1)
    border = torch.cat([shot.alpha[[0, -1]].flatten(), shot.alpha[:, [0, -1]].flatten()])
    assert border.max() == 0
    assert 0.05 < shot.alpha.max() < 0.5
    colour = torch.tensor(mean_colour(scene.appearance, scene.exposure))[:, None, None]
    assert (scene.background - colour).norm(dim=0).min() >= 0.399
    assert not render_sharp(scene).image.clipped.any()


def test_the_striped_preset_s_background_is_far_off_the_plane_of_its_pigments():
    scene = preset_scene("striped", size=SIZE)
    first, second = torch.tensor(pigments(scene.appearance))
    normal = torch.nn.functional.normalize(torch.linalg.cross(first, second), dim=0)
    assert torch.einsum("c,chw->hw", normal, scene.background).abs().min() > 0.15


@pytest.mark.parametrize(
    ("preset", "estimator", "told"), [("shaded", "known-shading", 0), ("striped", "two-colour", 2)]
)
def test_a_patterned_ball_comes_with_a_sharp_picture_and_its_estimator(
    tmp_path, preset, estimator, told
):
    shot = render_shot(preset_scene(preset, size=SIZE), step=2.0, supersampling=1)
    sharp = render_sharp(shot.scene, seed=4)
    write_shot(tmp_path, shot, sharp=sharp, format="png")
    picture = read_image(tmp_path / "ball.png").rgb
    assert (picture - sharp.image.rgb.clamp(0, 1)).abs().max() <= 0.51 / 65535
    rig = read_rig(tmp_path / "rig.toml")
    assert rig.estimator == estimator
    colours = pigments(shot.scene.appearance)
    assert rig.ball_colours == colours[:told]
    assert rig.ball == tmp_path / "ball.toml"
    ball = read_ball(rig.ball)
    assert (ball.sharp.image, ball.sharp.disc) == (tmp_path / "ball.png", sharp.disc)
    if told:
        assert ball.colours == colours
        assert abs(np.dot(ball.colours, ball.plane_normal)).max() < 1e-9
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert [tuple(colour) for colour in truth["ball"]["colours"]] == list(colours)
    assert truth["sharp_picture"]["position_m"] == pytest.approx(truth["position_m"])
    disc = truth["sharp_picture"]["disc"]
    assert (tuple(disc["centre_px"]), tuple(disc["semi_axes_px"])) == (
        sharp.disc.centre, sharp.disc.semi_axes
    )  # fmt: skip
    write_shot(tmp_path, SHOT)
    assert not (tmp_path / "ball.png").exists()
    assert read_rig(tmp_path / "rig.toml").ball is None


def test_an_unknown_preset_is_refused():
    with pytest.raises(ConfigError, match="no preset 'spiral'; there are straight"):
        preset_scene("spiral")
