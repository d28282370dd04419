import torch

from plugins.uniform import Uniform
from toolkit import Chord
from toolkit.sweep.shade import Shaded

COLOUR = (0.5, 0.4, 0.3)


def chord(count=9):
    offset = torch.linspace(-1, 1, count, dtype=torch.float64)
    return Chord(offset=offset, direction=torch.zeros(1, dtype=torch.float64))


def shaded(**options):
    return Shaded(estimator=Uniform(colour=COLOUR), channels=3, **options)


def test_without_a_shade_it_is_the_other_estimator_s_ball():
    one, base = shaded(), Uniform(colour=COLOUR)
    none = torch.zeros(6, dtype=torch.float64)
    for appearance in (None, none):
        assert torch.allclose(one.foreground(chord(), appearance), base.foreground(chord(), None))
    assert one.unknowns() == one.shades == 6


def test_the_first_power_leans_the_second_lights_both_rims():
    lean = torch.tensor([0.1, 0, 0, 0, 0, 0], dtype=torch.float64)
    rims = torch.tensor([0, 0, 0, 0, 0.2, 0], dtype=torch.float64)
    s = chord().offset
    plain = shaded().foreground(chord(), None)
    assert torch.allclose((shaded().foreground(chord(), lean) - plain)[:, 0], 0.1 * s)
    lit = (shaded().foreground(chord(), rims) - plain)[:, 1]
    assert torch.allclose(lit, 0.2 * (s * s - 1 / 3))


def test_slopes_are_the_change_with_the_offset():
    looks = torch.tensor([0.1, -0.2, 0.05, 0.3, 0.1, -0.1], dtype=torch.float64)
    one = chord(50)
    value, slope = shaded().foreground_and_slope(one, looks)
    assert torch.equal(value, shaded().foreground(one, looks))
    step = 1e-6
    ahead, back = (
        shaded().foreground(Chord(offset=one.offset + d, direction=one.direction), looks)
        for d in (step, -step)
    )
    assert torch.allclose(slope, (ahead - back) / (2 * step), atol=1e-8)


def test_it_keeps_the_unknowns_below_it():
    open_colour = Shaded(estimator=Uniform(), channels=3)
    assert open_colour.unknowns() == 9
    looks = torch.tensor([*COLOUR, 0.1, 0, 0, 0, 0, 0], dtype=torch.float64)
    known = shaded().foreground(chord(), looks[3:])
    assert torch.allclose(open_colour.foreground(chord(), looks), known)


def test_a_finer_shade_takes_the_next_powers():
    base = Uniform(colour=COLOUR)
    assert Shaded.powers_above(Uniform()) == (1, 2)
    first = Shaded(estimator=base, channels=3)
    assert Shaded.powers_above(first) == (3, 4)
    finer = Shaded(estimator=first, channels=3, powers=Shaded.powers_above(first))
    assert finer.shades == finer.unknowns() == 12
    looks = torch.zeros(12, dtype=torch.float64)
    looks[6] = 0.1
    s = chord().offset
    change = finer.foreground(chord(), looks) - base.foreground(chord(), None)
    assert torch.allclose(change[:, 0], 0.1 * s**3)


def test_a_ball_of_known_colour_may_show_another_once_it_is_shaded():
    base = Uniform(colour=COLOUR)
    assert Shaded.powers_above(base) == (0, 1, 2)
    one = shaded(powers=(0, 1, 2))
    assert one.is_recoloured
    assert Shaded(estimator=one, channels=3, powers=(3, 4)).is_recoloured
    assert not shaded().is_recoloured
    looks = torch.tensor([0.1, -0.2, 0.05, 0, 0, 0, 0, 0, 0], dtype=torch.float64)
    value, slope = one.foreground_and_slope(chord(), looks)
    plain = base.foreground(chord(), None)
    assert torch.allclose(value, plain + looks[:3])
    assert torch.equal(slope, torch.zeros_like(slope))


def test_light_ahead_shows_on_parts_of_a_chord_alone():
    one = shaded(is_ahead=True)
    assert one.unknowns() == one.shades == 9
    assert one.looks_ahead
    assert Shaded(estimator=one, channels=3, powers=(3, 4)).looks_ahead
    assert not shaded().looks_ahead
    looks = torch.tensor([0.0] * 6 + [0.2, 0.1, 0.0], dtype=torch.float64)
    plain = Uniform(colour=COLOUR).foreground(chord(), None)
    assert torch.allclose(one.foreground(chord(), looks), plain)
    s = chord().offset
    leading = Chord(offset=s, direction=chord().direction, start=0.0, stop=1.0)
    expected = torch.tensor([0.2, 0.1, 0.0], dtype=torch.float64) * (1 - s * s).sqrt()[:, None] / 2
    assert torch.allclose(one.foreground(leading, looks) - plain, expected)
    above = Shaded(estimator=one, channels=3, powers=(3, 4))
    more = torch.cat([looks, torch.zeros(6, dtype=torch.float64)])
    assert torch.equal(above.ahead(more), looks[6:])


def test_light_ahead_is_the_mean_of_the_ball_s_light_along_the_part():
    """Against the light summed up along parts of chords of a ball lit linearly from the front."""
    one, lean = shaded(is_ahead=True), 0.3
    looks = torch.tensor([0.0] * 6 + [lean, 0.0, 0.0], dtype=torch.float64)
    for offset, start, stop in ((0.3, -1.0, -0.2), (-0.6, -0.5, 0.9), (0.0, 0.4, 1.0)):
        places = torch.linspace(start, stop, 2001, dtype=torch.float64)
        ahead = places * (1 - offset * offset) ** 0.5
        expected = COLOUR[0] + lean * float(ahead.mean())
        part = Chord(
            offset=torch.tensor([offset], dtype=torch.float64),
            direction=torch.zeros(1, dtype=torch.float64),
            start=start,
            stop=stop,
        )
        assert abs(float(one.foreground(part, looks)[0, 0]) - expected) < 1e-9
