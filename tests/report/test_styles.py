"""One style a receiver, always the same, and none twice."""

import itertools
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


def test_no_two_of_many_receivers_look_the_same():
    styles = receiver_styles(
        [*OURS, *(f"learned_{number}" for number in range(30))]
    ).values()
    looks = [(style.colour, style.marker) for style in styles]
    assert len(set(looks)) == len(looks)


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


def test_known_colours_stay_apart_for_each_kind_of_colour_blindness():
    # Machado, Oliveira and Fernandes 2009, severity 1: linear RGB as protan, deutan and tritan eyes see it.
    kinds = {
        "protan": (
            (0.152, 1.053, -0.205),
            (0.115, 0.786, 0.099),
            (-0.004, -0.048, 1.052),
        ),
        "deutan": (
            (0.367, 0.861, -0.228),
            (0.280, 0.673, 0.047),
            (-0.012, 0.043, 0.969),
        ),
        "tritan": (
            (1.256, -0.077, -0.179),
            (-0.078, 0.931, 0.148),
            (0.005, 0.691, 0.304),
        ),
    }
    colours = {style.colour for style in receiver_styles(OURS).values()}
    assert len(colours) == len(OURS)
    for matrix in kinds.values():
        seen = [_seen(colour, matrix) for colour in colours]
        for one, other in itertools.combinations(seen, 2):
            assert (
                sum((a - b) ** 2 for a, b in zip(one, other, strict=True)) ** 0.5 > 0.15
            )


def _seen(colour, matrix):
    """What an eye makes of a colour, back in display values 0 to 1."""
    linear = [(int(colour[i : i + 2], 16) / 255) ** 2.2 for i in (1, 3, 5)]
    mixed = [
        sum(weight * part for weight, part in zip(row, linear, strict=True))
        for row in matrix
    ]
    return [min(1.0, max(0.0, part)) ** (1 / 2.2) for part in mixed]
