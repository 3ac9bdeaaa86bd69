"""Result records, the tables that are made of them, the paper's own numbers, and the victims' cards.

Reading them loads neither torch nor MuJoCo.
"""
