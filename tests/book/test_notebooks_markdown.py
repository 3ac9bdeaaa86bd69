"""MyST becomes Markdown that JupyterLab shows, and what has no plain form is refused."""

import pytest
from plain_markdown import Labels, collect, plain, read_citations


@pytest.fixture
def labels():
    return Labels(
        figures={"fig-a": "2.1"},
        equations={"eq-a": "2.3"},
        headings={"sec-a": "The ball"},
        citations={"xiong2022": ("Xiong et al.", "2022"), "zhang2020": ("Zhang and Chen", "2020")},
    )


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("see {numref}`fig-a`", "see Figure 2.1"),
        ("see {eq}`eq-a`", "see (2.3)"),
        ("see {ref}`sec-a`", "see *The ball*"),
        ("see {ref}`above <sec-a>`", "see above"),
        ("a role goes on: {ref}`above and\nbelow <sec-a>`", "a role goes on: above and below"),
        ("{doc}`the first chapter <01-mdp>`", "[the first chapter](01-mdp.ipynb)"),
        ("{doc}`that page <../paper-and-code>`", "[that page](../book/chapters/../paper-and-code.md)"),
        ("[the first](01-mdp.md) or [there](01-mdp.md#sec-a)", "[the first](01-mdp.ipynb) or [there](01-mdp.ipynb)"),
        ("{cite:p}`xiong2022,zhang2020`", "(Xiong et al., 2022; Zhang and Chen, 2020)"),
        ("{cite:t}`xiong2022` show", "Xiong et al. (2022) show"),
        ("`{numref}` is a role, $x$ and [a link](https://example.org) stay", None),
        ("$$ x = 1 $$ (eq-a)", r"$$ x = 1 \tag{2.3} $$"),
        ("$$\nx = 1\n$$ (eq-a)", "$$\nx = 1\n\\tag{2.3} $$"),
        ("```{math}\n:label: eq-a\nx = 1\n```", "$$\nx = 1\n\\tag{2.3}\n$$"),
        ("(sec-a)=\n## The ball", "## The ball"),
        ("```python\n{numref}`fig-a`\n```", None),
        ("```{code-block} bash\nmake book\n```", "```bash\nmake book\n```"),
        ("```{raw} html\n<b>x</b>\n```\nafter", "after"),
        ("```{note}\nA ball {eq}`eq-a`.\n\nMore.\n```", "> **Note**\n>\n> A ball (2.3).\n>\n> More.\n"),
        (":::{admonition} Think\n:class: think\nWhy?\n:::", "> **Think**\n>\n> Why?\n"),
        (
            "````{dropdown} The reasons\n```{tip}\nyes\n```\n````",
            "<details>\n<summary>The reasons</summary>\n\n> **Tip**\n>\n> yes\n\n\n</details>\n",
        ),
        (
            "```{figure} ../images/x.svg\n:name: fig-a\n:alt: a cat\nThe caption,\nof {cite:t}`xiong2022`.\n```",
            "![a cat](../book/images/x.svg)\n\n**Figure 2.1.** The caption, of Xiong et al. (2022).\n",
        ),
        (
            "```{recording} ../../data/r/h.rrd\n:still: ../../data/f/h.png\n:alt: three robots\nThey hop.\n```",
            "![three robots](../data/f/h.png)\n\nThey hop.\n",
        ),
        (
            "```{playground} scene=fall\n:still: ../../data/f/h.png\n:alt: one\nFell {scene}`it <scene=fall>`.\n```",
            "![one](../data/f/h.png)\n\nFell it.\n",
        ),
    ],
)
def test_plain_form(source, expected, labels):
    assert "\n".join(plain(source.split("\n"), labels)) == (source if expected is None else expected)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("```{tab-set}\n```", "tab-set"),
        ("{glue}`x`", "glue"),
        ("{numref}`fig-z`", "no figure is called 'fig-z'"),
        ("{cite:t}`nobody1999`", "no citation is called 'nobody1999'"),
        ("$$ x $$ (eq-z)", "no equation is called 'eq-z'"),
        ("```{note}\nnever closed", "never closed"),
    ],
)
def test_what_has_no_plain_form_is_refused(source, message, labels):
    with pytest.raises(ValueError, match=message):
        plain(source.split("\n"), labels)


def test_labels_are_numbered_in_reading_order_also_inside_directives():
    numbers, found = iter("123"), Labels()
    source = "(here)=\n### A *heading*\n\n````{note}\n$$ x $$ (eq-a)\n````\n```{figure} x.png\n:name: fig-a\n```\n"
    source += "$$ y $$ (eq-b)"
    collect(source.split("\n"), found, lambda kind: f"{kind} {next(numbers)}")
    assert (found.headings, found.figures) == ({"here": "A *heading*"}, {"fig-a": "figure 2"})
    assert found.equations == {"eq-a": "equation 1", "eq-b": "equation 3"}


@pytest.mark.parametrize("name", ["", "fig-a"])
def test_a_figure_needs_a_name_of_its_own(name, labels):
    with pytest.raises(ValueError, match="needs a name"):
        collect(["```{figure} x.png", f":name: {name}", "```"], labels, lambda kind: "2.2")


def test_citations_are_read_from_the_bibliography(tmp_path):
    (tmp_path / "r.bib").write_text(
        "@article{one, author={Solo, Han}, title={T}, year={1977}}\n"
        "@article{two, author={van Rossum, Guido and {\\'E}mile, Zola}, title={T}, year={1991}}\n"
        "@article{three, author={A, B and C, D and E, F}, title={T}, year={2000}}\n"
    )
    citations = read_citations(tmp_path / "r.bib")
    assert citations["one"] == ("Solo", "1977") and citations["three"] == ("A et al.", "2000")
    assert citations["two"][0].startswith("van Rossum and ")
