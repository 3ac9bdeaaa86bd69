import base64
import io
import re

import matplotlib

matplotlib.use("agg")

import matplotlib.pyplot as plt
import pytest
from ipywidgets.embed import dependency_state, embed_data
from PIL import Image

from detden_lite.looking.widgets import frames


def draw(value):
    figure, axes = plt.subplots(figsize=(3, 2))
    axes.bar([0], [value])
    return figure


def pictures(box):
    return [child.value for child in box.children[1].children]


def test_every_value_has_its_own_described_picture():
    box = frames(draw, [1, 2, 3], "height", lambda value: f'a bar of height "{value}"')
    found = pictures(box)
    assert len(set(found)) == 3
    assert 'alt="a bar of height &quot;2&quot;"' in found[1]
    data = base64.b64decode(re.search(r"base64,([^\"]+)", found[0])[1])
    assert Image.open(io.BytesIO(data)).size == (330, 220)


def test_the_slider_shows_the_names_and_begins_at_the_start():
    box = frames(draw, [0.1, 0.2], "epsilon", str, names=["small", "large"], start=1)
    slider = box.children[0].children[-1]
    assert [name for name, _ in slider.options] == ["small", "large"]
    assert slider.index == box.children[1].selected_index == 1


def test_a_play_button_covers_all_frames():
    button, slider = frames(draw, [1, 2, 3], "step", str, play=100).children[0].children
    assert (button.min, button.max, button.interval) == (0, 2, 100)


def test_the_browser_alone_moves_the_frames():
    """Slider and pictures are joined by a link in the browser, not by a callback in Python."""
    box = frames(draw, [1, 2], "height", str)
    state = embed_data([box], state=dependency_state([box]))["manager_state"]["state"].values()
    (link,) = [model["state"] for model in state if model["model_name"] == "LinkModel"]
    slider, stack = box.children[0].children[-1], box.children[1]
    assert link["source"] == [f"IPY_MODEL_{slider.model_id}", "index"]
    assert link["target"] == [f"IPY_MODEL_{stack.model_id}", "selected_index"]


def test_no_figure_stays_open():
    before = plt.get_fignums()
    frames(draw, [1, 2], "height", str)
    assert plt.get_fignums() == before


@pytest.mark.parametrize("values, names", [([], None), ([1, 1], None), ([1, 2], ["one"])])
def test_values_without_names_of_their_own_are_refused(values, names):
    with pytest.raises(ValueError, match="name of its own"):
        frames(draw, values, "height", str, names=names)
