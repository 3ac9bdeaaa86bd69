"""Interactive figures that need no kernel: every frame is drawn beforehand, and the browser chooses which one is shown.

So they work in the built book, where no Python runs, as they do in JupyterLab.
"""

import base64
import html
import io
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib.pyplot as plt
from ipywidgets import HTML, HBox, Layout, Play, SelectionSlider, Stack, VBox, jslink
from matplotlib.figure import Figure
from PIL import Image

PALETTE_SIZE = 128  # of a frame's PNG: a figure needs no more, and it is a third as large


def frames(
    draw: Callable[[Any], Figure],
    values: Sequence,
    label: str,
    describe: Callable[[Any], str],
    *,
    names: Sequence[str] | None = None,
    start: int = 0,
    play: int | None = None,
    dpi: int = 110,
) -> VBox:
    """A slider over figures.

    Args:
        draw: gives the figure of a value; it is closed afterwards. Figures of one size keep the page from jumping.
        values: one a frame.
        label: the text before the slider, such as "epsilon".
        describe: gives the alternative text of a value's figure: what the figure shows.
        names: the text behind the slider for each value; ``str`` of the value by default.
        start: position of the frame that is shown first.
        play: milliseconds a frame lasts, for a play button; None for no button.
        dpi: resolution of the frames.

    Raises:
        ValueError: if there are no values, not one name for each value, or two values with the same name.

    Example:
        >>> import matplotlib.pyplot as plt
        >>> from detden_lite import frames
        >>> box = frames(lambda size: plt.figure(figsize=(size, 1)), [1, 2], "size", "a figure {} inches wide".format)
        >>> box.children[0].children[0].description
        'size'
    """
    names = [str(value) for value in values] if names is None else list(names)
    if not len(values) or len(names) != len(values) or len(set(names)) != len(names):
        raise ValueError(f"values: {len(values)} of them with the names {names}; give each value a name of its own")
    pictures = [HTML(_image(draw(value), describe(value), dpi)) for value in values]
    stack = Stack(pictures, selected_index=start)
    slider = SelectionSlider(
        options=[(name, i) for i, name in enumerate(names)],
        index=start,
        description=label,
        style={"description_width": "initial"},
        layout=Layout(width="100%", max_width="36rem"),
    )
    jslink((slider, "index"), (stack, "selected_index"))
    controls = [slider]
    if play is not None:
        button = Play(value=start, min=0, max=len(values) - 1, interval=play)
        jslink((button, "value"), (slider, "index"))
        controls.insert(0, button)
    return VBox([HBox(controls), stack])


def _image(figure: Figure, description: str, dpi: int) -> str:
    """An HTML image of a figure, with its alternative text, as wide as the page lets it be."""
    width = round(figure.get_figwidth() * 96)
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=dpi)
    plt.close(figure)
    small = io.BytesIO()
    Image.open(file).convert("RGB").quantize(PALETTE_SIZE).save(small, format="png", optimize=True)
    data = base64.b64encode(small.getvalue()).decode()
    alt = html.escape(description, quote=True)
    return f'<img alt="{alt}" style="width: {width}px; max-width: 100%" src="data:image/png;base64,{data}">'
