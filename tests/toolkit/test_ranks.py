import numpy as np
import pytest

from toolkit.ranks import ranked_value


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
def test_it_is_a_quantile_that_was_seen(share):
    values = np.random.default_rng(1).normal(size=(3, 4, 101))
    np.testing.assert_array_equal(ranked_value(values, share), np.quantile(values, share, axis=-1))


def test_it_keeps_the_type():
    assert ranked_value(np.ones(7, np.float32)).dtype == np.float32
