"""The toolkit's checks, on a shiny grey ball before green."""

from chroma_key import ChromaKey

from toolkit.synthetic import LitBall, PlainBall
from toolkit.testing import Sample, estimator_checks, make_sample


def shaded_ball() -> Sample:
    """Render the ball, lit from one side."""
    appearance = LitBall(pattern=PlainBall(colour=(0.8, 0.8, 0.8)), highlight=0.1)
    return make_sample(appearance, background_colour=(0.1, 0.5, 0.15))


@estimator_checks(ChromaKey, make_sample=shaded_ball)
def test_it_keeps_what_the_interface_promises(check):
    """Make one of the toolkit's checks."""
    check()
