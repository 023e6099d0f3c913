"""Which optimizers are compared, and with which of their settings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.points import MODELS, Fit, Model, Optimizer, PointSet
from accelcal_cli.optimize import all_optimizers, named_optimizer

USUAL = ("fixed32", "fixed32:paper", "float64:paper", "fixed16", "gauss-newton")
ALL = "all"


@dataclass(frozen=True, slots=True)
class Method:
    """An optimizer with the settings of one profile."""

    optimizer: Optimizer
    profile: str = "default"

    @property
    def label(self) -> str:
        """NAME, or NAME:PROFILE."""
        return self.optimizer.name + ("" if self.profile == "default" else f":{self.profile}")

    @property
    def model(self) -> Model:
        """Nine parameters where it can fit them, else scale and offset."""
        return MODELS["9" if "9" in self.optimizer.models else "6"]

    @property
    def settings(self) -> Any:
        """The optimizer's own numbers."""
        return self.optimizer.settings[self.profile]

    def fit(self, points: PointSet) -> Fit:
        """Fit its model; raises DivergedError."""
        return self.optimizer.fit(points, self.model, self.settings)


def methods(labels: tuple[str, ...]) -> tuple[Method, ...]:
    """Methods by label, each once; `all` stands for every one whose packages are installed.

    Raises:
        UsageError: no such optimizer, or it has no such profile.
    """
    chosen: dict[str, Method] = {}
    for label in labels or USUAL:
        for method in _installed() if label == ALL else [_method(label)]:
            chosen.setdefault(method.label, method)
    return tuple(chosen.values())


def _method(label: str) -> Method:
    name, _, profile = label.partition(":")
    optimizer = named_optimizer(name)
    if (profile or "default") not in optimizer.settings:
        raise UsageError(
            f"optimizer {name} has no settings of profile {profile!r}",
            hint=f"one of {', '.join(sorted(optimizer.settings))}",
        )
    return Method(optimizer, profile or "default")


def _installed() -> Iterator[Method]:
    """Every optimizer, and those with other settings in profile `paper` once more."""
    for optimizer in all_optimizers():
        if optimizer.needs is not None and find_spec(optimizer.needs) is None:
            continue
        yield Method(optimizer)
        if optimizer.settings.get("paper", optimizer.settings["default"]) != optimizer.settings["default"]:
            yield Method(optimizer, "paper")
