"""What is said of logs one by one."""

import pytest

from ident.display import render
from ident.streams.many_logs import Disagreement, LogComparison, LogRow


def odd(share=0.99, parts=("hand", "forearm"), clear=True):
    return Disagreement(1e-9, clear, "hand.m", 0.5, 0.01, "kg", parts, share)


def logs(*disagreements, own=0.01):
    found = [
        LogRow(f"{i}.csv", 500, 1.1 * own, own, "elbow", d) for i, d in enumerate(disagreements)
    ]
    return LogComparison(tuple(found))


def test_a_model_that_leaves_much_is_not_said_to_fit_all_logs():
    same = odd(clear=False)
    assert "no log disagrees with the others; of 100 folders" in render(
        logs(same, same, same), "sentence"
    )
    poor = render(logs(same, same, same, own=0.45), "sentence")
    assert "45 %" in poor
    assert "see what it lacks first" in poor


def test_two_logs_disagree_with_each_other():
    assert "0.csv and 1.csv disagree with each other" in render(logs(odd(), odd()), "sentence")
    assert "0.csv disagrees with the others" in render(
        logs(odd(), odd(clear=False), odd(clear=False)), "sentence"
    )


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (odd(), "hand.m by +0.5 ± 0.01 kg; each of hand, forearm explains 99 %"),
        (odd(parts=("hand",)), "hand.m by +0.5 ± 0.01 kg; hand explains 99 %"),
        (odd(share=0.6), "no part of the model alone: hand explains 60 %"),
    ],
)
def test_what_differs_is_named_as_far_as_it_can_be(found, said):
    same = odd(clear=False)
    assert said in " ".join(str(logs(found, same, same)).split())
