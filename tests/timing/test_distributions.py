"""Distributions: exact means, units, what is refused."""

import math

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from scanhsi.timing.distributions import AnyDistribution, Distribution, sample_ns

_ADAPTER: TypeAdapter[AnyDistribution] = TypeAdapter(AnyDistribution)

MEANS_MS = {
    "constant": ({"kind": "constant", "unit": "ms", "value": 8.69}, 8.69),
    "uniform": ({"kind": "uniform", "unit": "ms", "low": 1, "high": 4}, 2.5),
    "lognormal, mean": ({"kind": "lognormal", "unit": "ms", "mean": 2.04, "cv": 0.1}, 2.04),
    "lognormal, median": ({"kind": "lognormal", "unit": "ms", "median": 2, "sigma": 0.3}, 2 * math.exp(0.045)),
    "halfnormal": ({"kind": "halfnormal", "unit": "us", "sigma": 150}, 0.15 * math.sqrt(2 / math.pi)),
    "gamma": ({"kind": "gamma", "unit": "ms", "shape": 2, "mean": 1.75}, 1.75),
    "exponential": ({"kind": "exponential", "unit": "ms", "mean": 4}, 4.0),
    "exponential, capped": ({"kind": "exponential", "unit": "ms", "mean": 4, "cap": 2}, 4 * (1 - math.exp(-0.5))),
    "quantile": ({"kind": "quantile", "unit": "ms", "knots": [[0, 1], [0.5, 2], [1, 7]]}, 0.5 * 1.5 + 0.5 * 4.5),
    "quantile, mean": ({"kind": "quantile", "unit": "ms", "knots": [[0, 1], [0.5, 2], [1, 7]], "mean": 3.3}, 3.3),
    "mixture": (
        {"kind": "mixture", "probability": 0.25, "of": {"kind": "constant", "unit": "ms", "value": 8}},
        2.0,
    ),
    "mixture of two": (
        {
            "kind": "mixture",
            "probability": 0.25,
            "of": {"kind": "constant", "unit": "ms", "value": 8},
            "otherwise": {"kind": "uniform", "unit": "ms", "low": 0, "high": 2},
        },
        2.75,
    ),
    "shifted": (
        {"kind": "shifted", "unit": "ms", "mean": 18.16, "of": {"kind": "halfnormal", "unit": "us", "sigma": 50}},
        18.16,
    ),
    "sum": (
        {
            "kind": "sum",
            "terms": [
                {"kind": "constant", "unit": "us", "value": 500},
                {"kind": "gamma", "unit": "ms", "shape": 3, "mean": 2},
                {"kind": "uniform", "unit": "ms", "low": 0, "high": 1},
            ],
        },
        3.0,
    ),
}


def parse(model: dict[str, object]) -> Distribution:
    return _ADAPTER.validate_python(model)


@pytest.mark.parametrize("name", MEANS_MS)
def test_means_are_exact_and_samples_agree(name: str) -> None:
    model, mean_ms = MEANS_MS[name]
    distribution = parse(model)
    assert distribution.mean_s == pytest.approx(mean_ms * 1e-3, rel=1e-12)
    u = np.random.default_rng(7).random((200_000, distribution.uniforms))
    drawn = sample_ns(distribution, u)
    assert drawn.dtype == np.int64
    assert drawn.min() >= 0
    error = 5 * drawn.std() / math.sqrt(drawn.size) + 1
    assert drawn.mean() == pytest.approx(mean_ms * 1e6, abs=error)


def test_spread_of_the_lognormal_is_its_cv() -> None:
    distribution = parse({"kind": "lognormal", "unit": "ms", "mean": 2.2, "cv": 0.12})
    drawn = sample_ns(distribution, np.random.default_rng(1).random((200_000, 1)))
    assert drawn.std() / drawn.mean() == pytest.approx(0.12, rel=0.02)


def test_cap_and_probability_are_kept() -> None:
    stall = {"kind": "mixture", "probability": 0.03, "of": {"kind": "exponential", "unit": "ms", "mean": 4, "cap": 40}}
    distribution = parse(stall)
    drawn = sample_ns(distribution, np.random.default_rng(1).random((300_000, distribution.uniforms)))
    assert (drawn > 0).mean() == pytest.approx(0.03, abs=0.002)
    assert drawn.max() <= 40_000_000


def test_sampling_is_monotone_in_its_uniform() -> None:
    """Common random numbers: a larger uniform is a longer delay, in every family."""
    u = np.linspace(0, 1, 1001)[:-1, None]
    for model, _ in MEANS_MS.values():
        distribution = parse(model)
        if distribution.uniforms == 1:
            assert (np.diff(sample_ns(distribution, u)) >= 0).all()


def test_quantile_table_reproduces_its_knots() -> None:
    distribution = parse({"kind": "quantile", "unit": "us", "knots": [[0, 3], [0.9, 5], [0.99, 50], [1, 80]]})
    assert sample_ns(distribution, np.array([[0.0], [0.9], [0.99]])).tolist() == [3000, 5000, 50_000]


@pytest.mark.parametrize(
    ("model", "complaint"),
    [
        ({"kind": "constant", "value": 1}, "unit"),
        ({"kind": "constant", "unit": "h", "value": 1}, "unit"),
        ({"kind": "constant", "unit": "ms", "value": -1}, "greater than or equal to 0"),
        ({"kind": "constant", "unit": "ms", "value": 1, "mean": 2}, "Extra inputs"),
        ({"kind": "poisson", "unit": "ms"}, "kind"),
        ({"kind": "uniform", "unit": "ms", "low": 2, "high": 1}, "below low"),
        ({"kind": "lognormal", "unit": "ms", "mean": 2, "sigma": 1}, "mean and cv, or median and sigma"),
        ({"kind": "quantile", "unit": "ms", "knots": [[0, 1], [0.9, 2]]}, "from 0 to 1"),
        ({"kind": "quantile", "unit": "ms", "knots": [[0, 2], [1, 1]]}, "nor fall"),
        (
            {"kind": "shifted", "unit": "ms", "mean": 1, "of": {"kind": "gamma", "unit": "ms", "shape": 1, "mean": 2}},
            "can be -0.001",
        ),
    ],
)
def test_nonsense_is_refused(model: dict[str, object], complaint: str) -> None:
    with pytest.raises(ValidationError, match=complaint):
        parse(model)
