"""The table of the recipe's stages on the book's page about it, from the library's list of stages."""

from detden_lite.recipe.stage_list import GROUPS, STAGES

NAMES = ("rule", "command", "what it does", "for which victims", "what it stores on the way")


def lines() -> list[list[str]]:
    """A line for each rule of data/Snakefile, in the order of the stages' groups; the columns are ``NAMES``."""
    ordered = sorted(STAGES.values(), key=lambda stage: list(GROUPS).index(stage.group))
    return [
        [
            f"<code>{rule}</code>",
            f"<code>detden {stage.name}</code>",
            stage.text,
            "all" if "online" in setting.split() else f"<code>{setting}</code>",
            stage.keeps,
        ]
        for stage in ordered
        for rule, setting in stage.rules.items()
    ]
