"""The whole report on the paper."""

from __future__ import annotations

from vocc_torch.show.report.document import Paragraph, Report, Section
from vocc_torch.studies.paper.report.contents import Contents
from vocc_torch.studies.paper.report.dimming_section import dimming
from vocc_torch.studies.paper.report.location_section import location
from vocc_torch.studies.paper.report.making_section import making
from vocc_torch.studies.paper.report.pictures import blocks_of
from vocc_torch.studies.paper.report.readings_section import readings
from vocc_torch.studies.paper.report.scorecard_section import scorecard_sections
from vocc_torch.studies.paper.report.summary_section import summary

PAPER = (
    "Do and Yoo, [A Multi-Feature LED Bit Detection Algorithm in Vehicular Optical Camera Communication]"
    "(https://doi.org/10.1109/ACCESS.2019.2928600), IEEE Access 7, 2019"
)
_RATES_TEXT = (
    "Scenes as in section IV-D; all receivers read the same frames. First the report's own reading, then "
    "every reading."
)
_OTHERS_TEXT = "Each from one frame or from a sample of 100, with its data as CSV."
_RATES = ("fig21", "fig22", "fig23", "fig24")
_BEYOND = ("dimming", "location")


def paper_report(contents: Contents) -> Report:
    """Put the report together; what was not measured is left out.

    Args:
        contents: everything that it shows.
    """
    card = contents.scorecard
    by_name = {figure.name: figure for figure in contents.figures}
    sections = [summary(contents)]
    if card is not None:
        sections += [*scorecard_sections(card), readings(card)]
    if contents.location:
        sections.append(location(contents.location, by_name.get("location")))
    rates = [by_name[name] for name in _RATES if name in by_name]
    others = [figure for figure in contents.figures if figure.name not in (*_RATES, *_BEYOND)]
    for title, anchor, text, figures in (
        ("Bit error rates: Figs 21 to 24", "rates", _RATES_TEXT, rates),
        ("The paper's other figures", "figures", _OTHERS_TEXT, others),
    ):
        if figures:
            sections.append(Section(title, anchor, (Paragraph(text),)))
            sections += [
                Section(figure.title, figure.name.replace("_", "-"), tuple(blocks_of(figure, card)), level=3)
                for figure in figures
            ]
    if contents.grids and "dimming" in by_name:
        sections.append(dimming(contents.grids, by_name["dimming"]))
    sections.append(making(contents))
    title = "The paper's whole evidence, reproduced and scored"
    return Report(title, f"{PAPER}, against `vocc_torch`", tuple(sections))
