"""Prior knowledge of a sensor, before any of its points is seen, and where it was learnt."""

from __future__ import annotations

from dataclasses import dataclass

from accelcal_cli.core.errors import Reason, printable

MG = 1e-3


@dataclass(frozen=True, slots=True)
class Prior:
    """Student's t distribution of each parameter, and the usual noise.

    The tails are heavy, since some sensors are far off.

    Attributes:
        centre: centres of the twelve parameters, in the order of PARAMETER_NAMES: entries of K, offsets [g]
            and their slopes [g per degree C].
        width: scale parameters of the distributions.
        freedom: degrees of freedom.
        noise_g: usual scatter of postures [g].
        noise_spread: scale parameter of the distribution of its logarithm, which also has heavy tails.
        noise_freedom: degrees of freedom of that distribution.
        reference_c: temperature of the offsets at the centre [degrees C]; None: at any.
    """

    centre: tuple[float, ...]
    width: tuple[float, ...]
    freedom: float
    noise_g: float
    noise_spread: float
    noise_freedom: float
    reference_c: float | None = None


POPULATION = Prior(
    centre=(1.0,) * 3 + (0.0,) * 9,
    width=(0.018,) * 3 + (0.013,) * 3 + (0.035,) * 3 + (0.001,) * 3,
    freedom=4.0,
    noise_g=1.5 * MG,
    noise_spread=0.3,
    noise_freedom=2.0,
)
"""Wrist and body-worn accelerometers at large; docs/prior.md says how it was chosen."""


@dataclass(frozen=True, slots=True)
class Source:
    """A recording that a prior was learnt from: its name in the study, and the hash of its bytes."""

    name: str
    sha256: str


@dataclass(frozen=True, slots=True)
class LearntPrior:
    """A prior from other recordings of a study.

    Attributes:
        kind: `study`: from other devices of the model; `device`: also from others of the device itself.
        devices, recordings: numbers of those of the model that were used; 0: the population instead.
        sha256: hash of the hashes of these recordings, sorted and joined; None without any.
        own: the device's other recordings that were used; empty for kind `study`.
    """

    prior: Prior
    kind: str
    model: str | None
    devices: int
    recordings: int
    sha256: str | None
    own: tuple[Source, ...] = ()

    def reason(self) -> Reason:
        """Return the note of a verdict on the prior."""
        model = printable(self.model or "")
        return Reason.of("prior_learnt", model=model, devices=self.devices, own=len(self.own))
