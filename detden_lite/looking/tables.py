"""HTML tables for the end of a notebook's cell."""

from collections.abc import Sequence

from IPython.display import HTML


def table(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> HTML:
    """A table for the end of a cell.

    Args:
        columns: their titles.
        rows: one entry for each column. Strings are shown as they are, and may be HTML. Other entries, such as an
            ``Estimate``, are shown as ``str`` gives them, with the line breaks of ``whole``.

    Example:
        >>> from detden_lite import figures
        >>> "<td>2</td>" in figures.table(["name", "value"], [["a", 1], ["b", 2]]).data
        True
    """

    def line(cells: Sequence[object], tag: str) -> str:
        shown = (cell if isinstance(cell, str) else whole(cell) for cell in cells)
        return "<tr>" + "".join(f"<{tag}>{cell}</{tag}>" for cell in shown) + "</tr>"

    body = "".join(line(row, "td") for row in rows)
    # The class tells themes that the output needs no light background on a dark page.
    return HTML(f'<table class="table dataframe"><thead>{line(columns, "th")}</thead><tbody>{body}</tbody></table>')


def whole(text: object) -> str:
    """The text of a table's entry. It may break into lines only before an interval: "3,376", then "[3,375, 3,376]"."""
    return str(text).replace(" ", "\N{NO-BREAK SPACE}").replace("\N{NO-BREAK SPACE}[", " [")
