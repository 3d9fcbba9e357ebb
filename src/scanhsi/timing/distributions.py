"""Distributions of one delay, written in JSON and sampled by inversion.

Every model turns uniforms into seconds through its quantile function instead of calling a random generator's own
`gamma()` or `normal()`. So a draw depends on nothing but its uniforms: the same on every machine and numpy version, and
a longer delay in one profile stays a longer delay in another (common random numbers).
"""

import math
from typing import Annotated, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy import special

Unit = Literal["s", "ms", "us", "ns"]
Seconds = NDArray[np.float64]

_SECONDS: dict[Unit, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


class Distribution(Protocol):
    """A distribution of non-negative delays."""

    @property
    def uniforms(self) -> int:
        """How many uniforms one draw takes."""
        ...

    @property
    def mean_s(self) -> float:
        """Exact mean in seconds."""
        ...

    def sample_s(self, u: Seconds) -> Seconds:
        """Delays in seconds, shape `(n,)`, from uniforms in [0, 1) of shape `(n, uniforms)`."""
        ...


def sample_ns(distribution: Distribution, u: Seconds) -> NDArray[np.int64]:
    """Delays in whole nanoseconds, shape `(n,)`, from uniforms of shape `(n, distribution.uniforms)`."""
    return np.rint(distribution.sample_s(u) * 1e9).astype(np.int64)


def least_s(distribution: Distribution) -> float:
    """The shortest delay that can be drawn, in seconds."""
    return float(distribution.sample_s(np.zeros((1, distribution.uniforms)))[0])


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _Leaf(_Model):
    unit: Unit

    @property
    def uniforms(self) -> int:
        return 1

    @property
    def _scale(self) -> float:
        return _SECONDS[self.unit]


class Constant(_Leaf):
    """Always `value`."""

    kind: Literal["constant"]
    value: float = Field(ge=0)

    @property
    def uniforms(self) -> int:
        """A constant takes no uniforms."""
        return 0

    @property
    def mean_s(self) -> float:
        """The value in seconds."""
        return self.value * self._scale

    def sample_s(self, u: Seconds) -> Seconds:
        """The same delay for every line."""
        return np.full(len(u), self.mean_s)


class Uniform(_Leaf):
    """Flat between `low` and `high`."""

    kind: Literal["uniform"]
    low: float = Field(ge=0)
    high: float = Field(ge=0)

    @model_validator(mode="after")
    def _ordered(self) -> "Uniform":
        if self.high < self.low:
            raise ValueError(f"high ({self.high}) is below low ({self.low})")
        return self

    @property
    def mean_s(self) -> float:
        """Middle of the interval, in seconds."""
        return 0.5 * (self.low + self.high) * self._scale

    def sample_s(self, u: Seconds) -> Seconds:
        """Delays in seconds."""
        return (self.low + (self.high - self.low) * u[:, 0]) * self._scale


class LogNormal(_Leaf):
    """Log-normal, by `mean` and `cv` (standard deviation / mean) or by `median` and `sigma` (of the logarithm)."""

    kind: Literal["lognormal"]
    mean: float | None = Field(default=None, gt=0)
    cv: float | None = Field(default=None, gt=0)
    median: float | None = Field(default=None, gt=0)
    sigma: float | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _one_pair(self) -> "LogNormal":
        given = tuple(name for name in ("mean", "cv", "median", "sigma") if getattr(self, name) is not None)
        if given not in (("mean", "cv"), ("median", "sigma")):
            raise ValueError(f"give mean and cv, or median and sigma (got {', '.join(given) or 'none'})")
        return self

    def _median_and_sigma(self) -> tuple[float, float]:
        if self.mean is not None and self.cv is not None:
            variance = math.log1p(self.cv**2)
            return self.mean * math.exp(-variance / 2), math.sqrt(variance)
        assert self.median is not None
        assert self.sigma is not None
        return self.median, self.sigma

    @property
    def mean_s(self) -> float:
        """Mean in seconds."""
        median, sigma = self._median_and_sigma()
        return median * math.exp(sigma**2 / 2) * self._scale

    def sample_s(self, u: Seconds) -> Seconds:
        """Delays in seconds."""
        median, sigma = self._median_and_sigma()
        return np.exp(special.ndtri(u[:, 0]) * sigma) * (median * self._scale)


class HalfNormal(_Leaf):
    """Absolute value of a normal with standard deviation `sigma`; its mean is sigma sqrt(2/pi)."""

    kind: Literal["halfnormal"]
    sigma: float = Field(gt=0)

    @property
    def mean_s(self) -> float:
        """Mean in seconds."""
        return self.sigma * math.sqrt(2 / math.pi) * self._scale

    def sample_s(self, u: Seconds) -> Seconds:
        """Delays in seconds."""
        return special.ndtri(0.5 + 0.5 * u[:, 0]) * (self.sigma * self._scale)


class Gamma(_Leaf):
    """Gamma with `shape` k and `mean` k theta."""

    kind: Literal["gamma"]
    shape: float = Field(gt=0)
    mean: float = Field(gt=0)

    @property
    def mean_s(self) -> float:
        """Mean in seconds."""
        return self.mean * self._scale

    def sample_s(self, u: Seconds) -> Seconds:
        """Delays in seconds."""
        return special.gammaincinv(self.shape, u[:, 0]) * (self.mean / self.shape * self._scale)


class Exponential(_Leaf):
    """min(Exp(`mean`), `cap`): the mean is that of the exponential before it is capped."""

    kind: Literal["exponential"]
    mean: float = Field(gt=0)
    cap: float | None = Field(default=None, gt=0)

    @property
    def mean_s(self) -> float:
        """Mean of the capped delay in seconds."""
        lost = math.exp(-self.cap / self.mean) if self.cap is not None else 0.0
        return self.mean * (1 - lost) * self._scale

    def sample_s(self, u: Seconds) -> Seconds:
        """Delays in seconds."""
        delay = -np.log1p(-u[:, 0]) * self.mean
        return (delay if self.cap is None else np.minimum(delay, self.cap)) * self._scale


class Quantile(_Leaf):
    """A measured distribution: quantiles `[[p, q], ...]` from p = 0 to p = 1, linear between them.

    Where the exact `mean` of the measurement is known, the table is rescaled to it: interpolation alone biases a
    long tail by a percent or so.
    """

    kind: Literal["quantile"]
    knots: tuple[tuple[float, float], ...] = Field(min_length=2)
    mean: float | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _sorted(self) -> "Quantile":
        p, q = self._table()
        if p[0] != 0 or p[-1] != 1 or bool(np.any(np.diff(p) <= 0)):
            raise ValueError("knots: p must rise from 0 to 1")
        if q[0] < 0 or bool(np.any(np.diff(q) < 0)):
            raise ValueError("knots: q must not be negative nor fall")
        if self.mean is not None and q[-1] == 0:
            raise ValueError("knots: all zero cannot have a mean")
        return self

    def _table(self) -> tuple[Seconds, Seconds]:
        table = np.asarray(self.knots, dtype=np.float64)
        return table[:, 0], table[:, 1]

    def _area(self) -> float:
        p, q = self._table()
        return float(np.sum(np.diff(p) * (q[1:] + q[:-1]))) / 2

    def _factor(self) -> float:
        return self._scale if self.mean is None else self.mean / self._area() * self._scale

    @property
    def mean_s(self) -> float:
        """Mean in seconds."""
        return self._area() * self._factor()

    def sample_s(self, u: Seconds) -> Seconds:
        """Delays in seconds."""
        p, q = self._table()
        return np.interp(u[:, 0], p, q) * self._factor()


class Mixture(_Model):
    """`of` with this probability, else `otherwise` (no delay if left out)."""

    kind: Literal["mixture"]
    probability: float = Field(ge=0, le=1)
    of: "AnyDistribution"
    otherwise: "AnyDistribution | None" = None

    @property
    def uniforms(self) -> int:
        """One to choose, then those of both parts."""
        return 1 + self.of.uniforms + (self.otherwise.uniforms if self.otherwise else 0)

    @property
    def mean_s(self) -> float:
        """Mean in seconds."""
        rest = self.otherwise.mean_s if self.otherwise else 0.0
        return self.probability * self.of.mean_s + (1 - self.probability) * rest

    def sample_s(self, u: Seconds) -> Seconds:
        """Delays in seconds."""
        split = 1 + self.of.uniforms
        rest = self.otherwise.sample_s(u[:, split:]) if self.otherwise else np.zeros(len(u))
        return np.where(u[:, 0] >= 1 - self.probability, self.of.sample_s(u[:, 1:split]), rest)


class Sum(_Model):
    """Sum of independent `terms`."""

    kind: Literal["sum"]
    terms: "tuple[AnyDistribution, ...]" = Field(min_length=1)

    @property
    def uniforms(self) -> int:
        """Those of all terms."""
        return sum(term.uniforms for term in self.terms)

    @property
    def mean_s(self) -> float:
        """Mean in seconds."""
        return sum(term.mean_s for term in self.terms)

    def sample_s(self, u: Seconds) -> Seconds:
        """Delays in seconds."""
        total = np.zeros(len(u))
        used = 0
        for term in self.terms:
            total += term.sample_s(u[:, used : used + term.uniforms])
            used += term.uniforms
        return total


class Shifted(_Leaf):
    """`of`, moved along the time axis so that its mean is exactly `mean`."""

    kind: Literal["shifted"]
    mean: float = Field(ge=0)
    of: "AnyDistribution"

    @model_validator(mode="after")
    def _never_negative(self) -> "Shifted":
        lowest = least_s(self)
        if lowest < 0:
            raise ValueError(f"moved to a mean of {self.mean} {self.unit} the delay can be {lowest:.3g} s")
        return self

    @property
    def uniforms(self) -> int:
        """Those of the distribution moved."""
        return self.of.uniforms

    @property
    def mean_s(self) -> float:
        """Mean in seconds."""
        return self.mean * self._scale

    def sample_s(self, u: Seconds) -> Seconds:
        """Delays in seconds."""
        return self.of.sample_s(u) + (self.mean_s - self.of.mean_s)


AnyDistribution = Annotated[
    Constant | Uniform | LogNormal | HalfNormal | Gamma | Exponential | Quantile | Mixture | Sum | Shifted,
    Field(discriminator="kind"),
]

Mixture.model_rebuild()
Sum.model_rebuild()
Shifted.model_rebuild()
