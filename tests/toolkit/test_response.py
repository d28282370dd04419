import importlib
import subprocess
import sys
import warnings

import numpy as np
import pytest

from toolkit.errors import ConfigError
from toolkit.response import (
    LINEAR,
    Response,
    SampledCurve,
    curve_names,
    decode_srgb,
    load_response,
    write_response,
)

CHANNEL = "brightness = [0.0, 0.5, 1.0]\nexposure = [0.0, 0.2, 1.0]\nstd = [0.0, 0.01, 0.02]\n"


def write(path, **channels):
    body = "".join(f"[channels.{name}]\n{text}" for name, text in channels.items())
    path.write_text(f'schema = "toolkit.response/1"\n{body}')
    return path


@pytest.mark.parametrize("name", ["linear", "LINEAR"])
def test_linear_divides_by_white(rng, name):
    stored = rng.integers(0, 65536, (4, 5, 3), dtype=np.uint16)
    light = load_response(name).decode(stored)
    assert light.dtype == np.float32
    np.testing.assert_allclose(light, stored.transpose(2, 0, 1) / 65535, atol=1e-7)


@pytest.fixture
def rng():
    return np.random.default_rng(3)


@pytest.fixture
def colour():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it complains about missing plotting packages
        return importlib.import_module("colour")


def test_srgb_agrees_with_colour_science_and_undoes_the_encoding(colour):
    brightness = np.linspace(0, 1, 2001)
    np.testing.assert_allclose(
        decode_srgb(brightness), colour.cctf_decoding(brightness, function="sRGB"), atol=1e-12
    )
    light = decode_srgb(brightness)
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(encoded, brightness, atol=1e-7)
    assert decode_srgb(np.array(-0.01)) == pytest.approx(-0.01 / 12.92)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_tables_and_formulas_agree(rng, dtype):
    white = np.iinfo(dtype).max
    stored = rng.integers(0, white + 1, (6, 7, 3)).astype(dtype)
    response = load_response("sRGB")
    np.testing.assert_allclose(response.decode(stored), response.decode(stored / white), atol=1e-6)


def test_grey_is_decoded_by_every_channel(tmp_path):
    other = CHANNEL.replace("0.2", "0.3")
    response = load_response(write(tmp_path / "r.toml", r=CHANNEL, g=other, b=CHANNEL))
    light = response.decode(np.full((2, 2), 0.5, np.float32))
    assert light[:, 0, 0] == pytest.approx([0.2, 0.3, 0.2])


def test_no_import_of_colour_science_for_the_common_responses():
    code = (
        "import sys; from toolkit.response import load_response; load_response('srgb'); "
        "load_response('linear'); sys.exit('colour' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("name", ["S-Log3", "s-log3", "ITU-R BT.709", "Gamma 2.2", "arri logc3"])
def test_named_curves_rise_to_white(name):
    response = load_response(name)
    light = response.light(np.linspace(0, 1, 100), 1)
    assert (np.diff(light) > 0).all()
    assert light[-1] == 1
    assert response.name.lower() == name.lower()


@pytest.mark.parametrize(
    ("said", "name"),
    [
        ("BT.709", "ITU-R BT.709"),
        ("rec709", "ITU-R BT.709"),
        ("slog3", "S-Log3"),
        ("C-Log", "Canon Log"),
        ("clog3", "Canon Log 3"),
        ("V-Log", "V-Log"),
        ("logc3", "ARRI LogC3"),
        ("HLG", "ARIB STD-B67"),
    ],
)
def test_curves_go_by_their_natural_names(said, name):
    assert load_response(said).name == name


def test_all_names_listed_can_be_used(colour):
    names = curve_names()
    assert names[:2] == ["linear", "srgb"]
    assert "DICOM GSDF" not in names  # it does not rise
    for name in names:
        assert (np.diff(load_response(name).light(np.linspace(0, 1, 64), 0)) >= 0).all()


def test_measured_curves_are_written_and_read_again(tmp_path):
    brightness = np.linspace(0, 1, 5)
    modes = np.array([[0, 0.01, 0, -0.01, 0], [0, 0, 0.02, 0, 0.0]])
    curve = SampledCurve(
        brightness=brightness,
        exposure=brightness**2,
        std=np.sqrt((modes**2).sum(0)),
        modes=modes,
    )
    path = tmp_path / "response.toml"
    write_response(path, (curve, curve, curve), {"times_s": [0.5, 1.0]})
    found = load_response(path)
    for one in found.curves:
        assert one.exposure.tolist() == curve.exposure.tolist()
        np.testing.assert_array_equal(one.changes, modes)


def test_doubt_tells_how_light_may_err():
    brightness = np.linspace(0, 1, 65)
    bend = brightness**2 * np.log(np.maximum(brightness**2, 1e-3))
    curves = [
        SampledCurve(
            brightness=brightness,
            exposure=brightness**2,
            std=np.abs(x * bend),
            modes=x * bend[None],
        )
        for x in (0.01, 0.02, 0.03)
    ]
    doubt = Response(name="measured", curves=tuple(curves)).doubt()
    assert doubt.changes.shape == (3, 3, 65)
    assert doubt.change(np.array(0.25), 1, 1) == pytest.approx(0.02 * 0.25 * np.log(0.25))
    assert doubt.change(np.array(0.25), 1, 0) == 0
    same = Response(name="measured", curves=(curves[1],) * 3).doubt()
    assert same.changes.shape == (1, 3, 65)
    assert same.exponent_std() == pytest.approx(0.02, rel=0.02)
    assert LINEAR.doubt() is None
    assert load_response("srgb").doubt() is None


def test_a_named_curve_is_proportional_to_colour_science(colour):
    brightness = np.linspace(0, 1, 50)
    expected = colour.models.log_decoding_SLog3(brightness)
    found = load_response("s-log3").light(brightness, 0)
    np.testing.assert_allclose(found, expected / expected[-1], atol=1e-7)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("slog33", "did you mean S-Log3"),
        ("srgbb", "sRGB"),
        ("qqqqqqqq", "give linear, srgb or a response.toml"),
        ("DICOM GSDF", "does not rise"),
    ],
)
def test_unknown_and_unusable_names(name, text):
    with pytest.raises(ConfigError, match=text):
        load_response(name)


def test_a_measured_response(tmp_path):
    path = write(tmp_path / "response.toml", r=CHANNEL, g=CHANNEL, b=CHANNEL)
    for spec in (path, str(path)):
        response = load_response(spec)
        assert response.name == str(path)
        light = response.light(np.array([-0.1, 0, 0.25, 0.5, 0.75, 1, 1.2]), 2)
        np.testing.assert_allclose(light, [-0.04, 0, 0.1, 0.2, 0.6, 1, 1], atol=1e-7)
        assert isinstance(response.curves[0], SampledCurve)
        assert response.curves[0].std.tolist() == [0.0, 0.01, 0.02]


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("exposure = [0.0, 0.2, 1.0]", "exposure = [0.0, 0.0, 1.0]", "'exposure' does not rise"),
        ("exposure = [0.0, 0.2, 1.0]", "exposure = [0.0, 0.2, 1.5]", "'exposure' does not rise"),
        ("brightness = [0.0, 0.5, 1.0]", "brightness = [0.5, 0.0, 1.0]", "'brightness' does not"),
        ("std = [0.0, 0.01, 0.02]", "std = [0.0, 0.01]", "3, 3 and 2 values"),
        ("std = [0.0, 0.01, 0.02]", "std = [0.0, -0.01, 0.02]", "negative"),
        ("std = [0.0, 0.01, 0.02]", "std = [0.0, nan, 0.02]", "not finite"),
        ("std = [0.0, 0.01, 0.02]", "std = [0.0, true, 0.02]", "not a number"),
        ("std = [0.0, 0.01, 0.02]", "std = 0.1", "a list is needed"),
        ("std = [0.0, 0.01, 0.02]", "", "lacks 'std'"),
        ("std = [0.0, 0.01, 0.02]", "std = [0.0]", "has 1 values"),
        ("std =", "modes = [[0.0, 0.1]]\nstd =", "needs 3 values"),
        ("std =", "modes = [0.1]\nstd =", "lists are needed"),
        ("std =", "stdev =", "unknown key 'stdev'"),
    ],
)
def test_bad_tables_are_named(tmp_path, old, new, text):
    bad = CHANNEL.replace(old, new)
    path = write(tmp_path / "r.toml", r=CHANNEL, g=bad, b=CHANNEL)
    with pytest.raises(ConfigError, match=text) as caught:
        load_response(path)
    assert "[channels.g]" in str(caught.value)


def test_missing_channels_files_and_schemas(tmp_path):
    with pytest.raises(ConfigError, match=r"lacks \[channels.b\]"):
        load_response(write(tmp_path / "r.toml", r=CHANNEL, g=CHANNEL))
    with pytest.raises(ConfigError, match="unknown key 'x'"):
        load_response(write(tmp_path / "r.toml", r=CHANNEL, g=CHANNEL, b=CHANNEL, x=CHANNEL))
    with pytest.raises(ConfigError, match="does not exist"):
        load_response("nowhere.toml")
    (tmp_path / "other").write_text('schema = "toolkit.camera/1"\n')
    with pytest.raises(ConfigError, match="schema"):
        load_response(str(tmp_path / "other"))


def test_linear_is_shared():
    assert load_response("linear") is LINEAR
