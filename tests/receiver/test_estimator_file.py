"""Archives of estimators that were crafted to take memory or time are refused before skops reads them."""

import json
import warnings
import zipfile
from io import BytesIO

import numpy as np
import pytest
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.svm import SVC
from skops import io as skops_io

from vocc_torch.errors import VoccError
from vocc_torch.receiver.classifiers.estimator_file import (
    TRUSTED,
    demand_bounded,
    unpacked,
)
from vocc_torch.receiver.model_file import parse_json

X = np.random.default_rng(0).normal(size=(200, 3))
Y = (X[:, 0] > 0).astype(int)
LARGE = np.zeros(1 << 20)


def parts_of(packed):
    with zipfile.ZipFile(BytesIO(packed)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def npy(array):
    buffer = BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def archive(penalty, parts, compression=zipfile.ZIP_STORED):
    """Write an honest estimator with another description of its penalty, and more parts."""
    whole = parts_of(skops_io.dumps(LogisticRegression().fit(X, Y)))
    schema = json.loads(whole.pop("schema.json"))
    schema["content"]["content"]["penalty"] = penalty
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as file:
        for name, content in {**whole, **parts}.items():
            file.writestr(name, content)
        file.writestr("schema.json", json.dumps(schema))
    return buffer.getvalue()


def node(loader, **keys):
    about = {"__class__": "list", "__module__": "builtins", "__loader__": loader}
    return about | keys


def laughs(depth, width):
    """Nest lists, each with the one before many times over."""
    number = node("JsonNode", content="0", __id__=100)
    inner = node("ListNode", content=[number] * width, __id__=101)
    for key in range(102, 100 + depth):
        again = [node("CachedNode", __id__=key - 1)] * (width - 1)
        inner = node("ListNode", content=[inner, *again], __id__=key)
    return inner


def array(name):
    about = {"__class__": "ndarray", "__module__": "numpy", "__loader__": "NdArrayNode"}
    return about | {"type": "numpy", "file": name}


CRAFTED = {
    "compressed": (
        {"penalty": array("a.npy"), "parts": {"a.npy": npy(LARGE)}},
        {"compression": zipfile.ZIP_BZIP2},
        "its parts are compressed",
    ),
    "an archive within": (
        {"penalty": array("a.npz"), "parts": {"a.npz": archive(None, {})}},
        {},
        "it has a part that is no array",
    ),
    "one part by many names": (
        {
            "penalty": node("ListNode", content=[array("a.npy")] * 10),
            "parts": {"a.npy": npy(LARGE)},
        },
        {},
        "it builds more than 67108864 bytes",
    ),
    "lists that multiply": (
        {"penalty": laughs(9, 10), "parts": {}},
        {},
        "it builds more than 67108864 bytes",
    ),
}


@pytest.mark.parametrize("case", CRAFTED)
def test_a_crafted_archive_is_refused(case):
    content, options, says = CRAFTED[case]
    with pytest.raises(VoccError, match=says):
        demand_bounded(archive(**content, **options))


def test_a_text_of_too_many_values_is_not_parsed():
    with pytest.raises(ValueError, match="more than 1048576 values"):
        parse_json(b"[" + b"[]," * (1 << 20) + b"0]")


@pytest.mark.parametrize(
    "estimator",
    [
        LogisticRegression(),
        SVC(),
        HistGradientBoostingClassifier(max_iter=20),
    ],
)
def test_honest_estimators_are_read(estimator):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        packed = skops_io.dumps(estimator.fit(X, Y))
        again = unpacked(packed, skops_io, lambda name: name in TRUSTED)
    np.testing.assert_array_equal(again.predict(X), estimator.predict(X))
