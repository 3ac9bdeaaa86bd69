"""Tables for the end of a notebook's cell: as HTML, and folded under a title as MyST Markdown."""

from collections.abc import Iterable, Sequence

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
        # A head without a text would be announced as one.
        tagged = ((tag if cell else "td", cell) for cell in shown)
        return "<tr>" + "".join(f"<{kind}>{cell}</{kind}>" for kind, cell in tagged) + "</tr>"

    body = "".join(line(row, "td") for row in rows)
    # The class tells themes that the output needs no light background on a dark page.
    return HTML(f'<table class="table dataframe"><thead>{line(columns, "th")}</thead><tbody>{body}</tbody></table>')


def folded_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table folded under its title, in MyST Markdown, for a cell of a page with ``markdown_format: myst``.

    Args:
        title: what is seen before it is opened.
        columns: their titles.
        rows: one entry for each column; shown as ``str`` gives them.

    Example:
        >>> print(folded_table("One", ["name", "value"], [["a", 1]]))
        :::{dropdown} One
        | name | value |
        |---|---|
        | a | 1 |
        :::
        <BLANKLINE>
    """
    lines = ["| " + " | ".join(map(str, row)) + " |" for row in (columns, *rows)]
    body = "\n".join([lines[0], "|---" * len(columns) + "|", *lines[1:]])
    return f":::{{dropdown}} {title}\n{body}\n:::\n"


def whole(text: object) -> str:
    """The text of a table's entry. It may break into lines only before an interval: "3,376", then "[3,375, 3,376]"."""
    return str(text).replace(" ", "\N{NO-BREAK SPACE}").replace("\N{NO-BREAK SPACE}[", " [")
