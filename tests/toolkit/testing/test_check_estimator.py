import pytest
import torch

from plugins.uniform import Uniform
from toolkit import ConfigError, registry
from toolkit.synthetic import LitBall, PlainBall, StripedBall
from toolkit.testing import (
    check_estimator,
    check_names,
    estimator_checks,
    make_sample,
    sample_for,
)

GREEN = (0.2, 0.6, 0.2)


@pytest.fixture(scope="module")
def sample():
    return make_sample(PlainBall(colour=GREEN))


def one(report, name):
    (result,) = (result for result in report.results if result.name == name)
    return result


@pytest.mark.parametrize("name", ["uniform", "two-colour", "known-shading"])
def test_the_built_in_ones_fail_nothing(name):
    sample = sample_for(registry.load(name))
    report = check_estimator(registry.build(name, given=sample.facts, options={}), sample=sample)
    assert report.failed == ()
    assert (report.estimator, report.ran, report.is_good) == (name, 24, True)


def test_one_with_unknowns_fails_nothing():
    assert Uniform().unknowns() == 3
    assert check_estimator(Uniform()).failed == ()


def test_a_report_is_a_table(sample):
    report = check_estimator(Uniform(colour=(0.6, 0.2, 0.2)), sample=sample, only=["truth-alpha"])
    lines = str(report).splitlines()
    assert len(lines) == 25
    assert lines[-1] == "uniform: ran 1 of 24, 1 failed"
    (failed,) = (line for line in lines if line.startswith("failed"))
    assert "truth-alpha" in failed
    assert "opacities err by" in failed
    assert sum(line.startswith("skipped") for line in lines) == 23
    assert all(result.promise.endswith(".") for result in report.results)


def test_an_expected_failure_is_told_with_its_reason(sample):
    report = check_estimator(
        Uniform(colour=(0.6, 0.2, 0.2)),
        sample=sample,
        only=["truth-alpha"],
        expected_failures={"truth-alpha": "the colour is a guess"},
    )
    assert report.is_good
    assert one(report, "truth-alpha").status == "expected"
    assert one(report, "truth-alpha").detail.startswith("the colour is a guess (opacities err")


def test_an_expected_failure_that_passes_is_a_failure(sample):
    report = check_estimator(
        Uniform(colour=GREEN),
        sample=sample,
        only=["truth-alpha"],
        expected_failures={"truth-alpha": "the colour is a guess"},
    )
    assert report.failed == ("truth-alpha",)
    assert "passes, though expected to fail (the colour is a guess)" in str(report)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ({"only": ["nonsense"]}, "no check 'nonsense'; there are: observe-shapes"),
        ({"expected_failures": {"nonsense": "x"}}, "no check 'nonsense'"),
        ({"expected_failures": {"cost": " "}}, "'cost' is expected without a reason"),
    ],
)
def test_a_wrong_name_or_no_reason_is_refused(sample, words, reason):
    with pytest.raises(ConfigError, match=reason):
        check_estimator(Uniform(), sample=sample, **words)


def test_authors_get_one_test_a_check(sample):
    made = []

    def make():
        made.append(1)
        return Uniform(colour=GREEN)

    mark = estimator_checks(
        make, make_sample=lambda: sample, expected_failures={"truth-alpha": "why not"}
    ).mark
    assert not made
    names, tests = mark.args
    assert names == "check"
    assert tuple(test.id for test in tests) == check_names()
    checks = {test.id: test.values[0] for test in tests}
    checks["observe-shapes"]()
    with pytest.raises(AssertionError, match=r"^truth-alpha: passes, though expected to fail"):
        checks["truth-alpha"]()


def test_authors_see_what_was_expected_and_what_failed(sample):
    wrong = estimator_checks(
        lambda: Uniform(colour=(0.6, 0.2, 0.2)),
        make_sample=lambda: sample,
        expected_failures={"truth-alpha": "a guess"},
    ).mark.args[1]
    checks = {test.id: test.values[0] for test in wrong}
    with pytest.raises(pytest.xfail.Exception, match=r"a guess \(opacities err"):
        checks["truth-alpha"]()
    with pytest.raises(AssertionError, match=r"^truth-measure: .* Measuring the sample finds"):
        checks["truth-measure"]()


def test_authors_learn_at_once_of_a_name_that_is_wrong():
    with pytest.raises(ConfigError, match="no check 'truth'"):
        estimator_checks(Uniform, expected_failures={"truth": "x"})


def test_the_sample_s_truth_explains_its_picture(sample):
    alpha = sample.alpha[sample.core]
    ball = torch.tensor(GREEN)[:, None]
    behind = sample.shot.clean_background[:, sample.core]
    mixture = alpha * ball + (1 - alpha) * behind
    assert torch.allclose(mixture, sample.shot.clean_image[:, sample.core], atol=2e-3)
    assert int(sample.core.sum()) > 3000


def test_the_sample_s_chords_follow_the_semi_ellipse(sample):
    chord = sample.core_chord
    # width over travel, both known from the scene: 1 / 4
    height = sample.alpha[sample.core] / (1 - chord.offset**2).sqrt()
    assert float((height - 0.25).abs().max()) < 0.005


def test_the_sharp_ball_of_a_sample_looks_like_it():
    pattern = LitBall(pattern=PlainBall(colour=GREEN), light=(-1.0, 0.0, 0.0), ambient=0.2)
    sharp = make_sample(pattern).facts["ball"].rgb
    middle = sharp.shape[-1] // 2
    assert torch.allclose(sharp[:, middle, middle], 0.2 * torch.tensor(GREEN), atol=1e-6)
    assert float(sharp[1, middle, 1]) > 0.95 * GREEN[1]
    assert torch.allclose(sharp[:, middle, -1], 0.2 * torch.tensor(GREEN), atol=1e-6)


def test_the_noise_of_a_sample_is_the_one_it_states(sample):
    light = torch.stack([image.rgb[0] for image, _ in sample.repeats])
    stated = sample.noise.variance(sample.shot.clean_image[None])[0]
    assert float((light.var(0) / stated).mean()) == pytest.approx(1, abs=0.02)
    behind = torch.stack([ground.rgb[0] for _, ground in sample.repeats])
    stated = sample.noise.variance(sample.shot.clean_background[None])[0] / sample.background.frames
    assert float((behind.var(0) / stated).mean()) == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(
    ("name", "kind"),
    [("uniform", PlainBall), ("two-colour", StripedBall), ("known-shading", LitBall)],
)
def test_the_ball_suits_the_estimator(name, kind):
    assert isinstance(sample_for(registry.load(name)).shot.scene.appearance, kind)


def test_colours_given_or_its_own_are_shown():
    assert sample_for(Uniform, colours=(GREEN,)).facts["colour"] == GREEN
    assert sample_for(Uniform(colour=GREEN)).facts["colour"] == GREEN
    sample = sample_for(Uniform, background_colour=(0.1, 0.6, 0.1))
    mean = sample.shot.clean_background.mean((1, 2))
    assert torch.allclose(mean, torch.tensor([0.1, 0.6, 0.1]), atol=0.03)


def test_black_and_white_span_no_plane():
    stripes = StripedBall(colours=((0.8, 0.8, 0.8), (0.1, 0.1, 0.1)))
    facts = make_sample(stripes).facts
    assert "plane_normal" not in facts
    assert facts["colours"] == stripes.colours
