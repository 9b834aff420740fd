"""Classifiers whose package is an extra that may not be installed: a study goes on without them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from importlib.util import find_spec

from vocc_torch.measure.plan import ReceiverPlan
from vocc_torch.measure.plug_in import TARGET

EXTRAS = {"sklearn": "scikit-learn"}
"""Packages that classifiers of the package's own configuration need, by the name that is imported."""


def without_absent(receiver: ReceiverPlan) -> tuple[ReceiverPlan, dict[str, str]]:
    """Leave out the classifiers whose package is not installed, and say why.

    Args:
        receiver: the receivers.

    Returns:
        The receivers that can be built, and the reason for each other one by its name.
    """
    absent = {name for name in EXTRAS if find_spec(name) is None}
    why = {one.name: sorted(absent & set(_packages(one.build))) for one in receiver.classifiers}
    left_out = {name: _reason(packages[0]) for name, packages in why.items() if packages}
    kept = tuple(one for one in receiver.classifiers if one.name not in left_out)
    names = tuple(name for name in receiver.names if name not in left_out)
    return replace(receiver, names=names, classifiers=kept), left_out


def _packages(build: Mapping[str, object]) -> Iterator[str]:
    """Give the packages of a configuration's classes, those within others too."""
    for key, value in build.items():
        if isinstance(value, Mapping):
            yield from _packages(value)
        elif key == TARGET:
            yield str(value).partition(".")[0]


def _reason(package: str) -> str:
    """Say how to get a package."""
    return f"{EXTRAS[package]} is not installed; pip install {EXTRAS[package]} adds it"
