"""How the numbers were made, as a section of the report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from vocc_torch.show.report.document import Block, Bullets, Code, Paragraph, Section, Table
from vocc_torch.show.report.inline import literal
from vocc_torch.studies.paper.report.contents import Contents, Facts


def making(contents: Contents) -> Section:
    """Say how the numbers were made."""
    facts = contents.facts
    blocks: list[Block] = [Code(facts.command)]
    blocks.append(Paragraph(f"{literal(facts.budget)}. {literal(facts.machine)}."))
    if facts.resumed:
        blocks.append(Paragraph("Frames that an earlier run had counted took no time in this one."))
    if facts.seconds:
        blocks.append(_times(facts))
    if contents.others:
        blocks.append(Bullets(tuple(f"{what}: [`{path}`]({path})" for what, path in contents.others.items())))
    blocks.append(_settings(facts))
    return Section("How this was made", "making", tuple(blocks))


def _times(facts: Facts) -> Table:
    """Give the wall-clock time by stage."""
    rows = [(literal(stage), f"{seconds:.1f}") for stage, seconds in facts.seconds.items()]
    rows.append(("all", f"{sum(facts.seconds.values()):.1f}"))
    return Table(("stage", "seconds"), tuple(rows), ("left", "right"), caption="Wall-clock time by stage")


def _settings(facts: Facts) -> Table:
    """Give the whole configuration, a key a row."""
    rows = tuple((f"`{key}`", literal(text)) for key, text in _flat(facts.configuration))
    return Table(("key", "value"), rows, caption="The whole configuration, by key", folded=True)


def _flat(settings: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Give nested settings as keys with dots and their values as Hydra's command line takes them."""
    for key, value in settings.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", _written(value)


def _written(value: object) -> str:
    """Write a value.

    Example:
        >>> _written(None), _written([18.0, True])
        ('null', '[18.0,true]')
    """
    if isinstance(value, (list, tuple)):
        return f"[{','.join(map(_written, value))}]"
    return {"None": "null", "True": "true", "False": "false"}.get(str(value), str(value))
