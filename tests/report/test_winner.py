"""The winner among the rows of a method's settings."""

from __future__ import annotations

import pandas as pd

from rbtm_bench.report import best_settings

MM = "final_translation_error_mm"


def test_the_winner_of_rows_by_hand() -> None:
    """The least error; a smaller window before a smaller threshold; a failed seed loses to any."""
    rows = pd.DataFrame(
        [
            ("done", 8, 0.1, 5.0),
            ("done", 4, 0.9, 5.0),
            ("done", 4, 0.5, 5.0),
            ("done", 2, 0.1, 6.0),
            ("1 of 2 done", 1, 0.0, 1.0),
            ("done", 1, 0.0, None),
        ],
        columns=["status", "window", "threshold", MM],
    )
    won = best_settings.winner(rows, MM)
    assert won is not None and (won["window"], won["threshold"], won[MM]) == (4, 0.5, 5.0)
    partly = best_settings.winner(rows[rows["status"] != "done"], MM)
    assert partly is not None and partly[MM] == 1.0
    assert best_settings.winner(rows[5:], MM) is None
