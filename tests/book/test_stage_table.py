"""The book's table of stages has every rule once."""

import stage_table

from detden_lite.recipe.stage_list import STAGES


def test_the_table_has_a_full_line_for_every_rule():
    rules = [f"<code>{rule}</code>" for stage in STAGES.values() for rule in stage.rules]
    lines = stage_table.lines()
    assert sorted(line[0] for line in lines) == sorted(rules)
    assert all(len(line) == len(stage_table.NAMES) for line in lines)
