"""One style a receiver, always the same, and none twice."""

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from vocc_torch.report.styles import receiver_styles

OURS = [
    "center_greyscale",
    "average_greyscale",
    "flda_agr",
    "flda_gri",
    "flda_2",
    "flda_3",
]


@given(st.permutations([*OURS, "cnn", "svm", "a_tree"]))
def test_styles_do_not_depend_on_the_order(names):
    styles = receiver_styles(names)
    assert list(styles) == names
    assert styles == receiver_styles(sorted(names))
    assert {name: styles[name] for name in OURS} == receiver_styles(OURS)


def test_every_shipped_classifier_has_a_title_and_looks_like_no_other():
    folder = Path(__file__).parents[2] / "conf" / "classifier"
    # Those two are for classifiers of a user's own.
    names = {path.stem for path in folder.glob("*.yaml")} - {"own", "sklearn"}
    styles = receiver_styles([*OURS, *sorted(names)])
    assert len(names) >= 12
    assert not [name for name in names if styles[name].label == name.replace("_", " ")]
    looks = [(style.colour, style.marker) for style in styles.values()]
    assert len(set(looks)) == len(looks)
    # In the default price list no two have the same colour.
    shown = (
        "center_greyscale",
        "average_greyscale",
        "flda_2",
        "flda_3",
        *sorted(names - {"flda_3_mix"}),
    )
    assert len({styles[name].colour for name in shown}) == len(shown)
