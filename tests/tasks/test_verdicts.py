"""How right a statement is about a machine whose causes are known."""

from typing import Any

import pytest

from tasks import verdicts


def statement(verdict: str, *named: tuple[str, float], ties: tuple[str, ...] = ()) -> dict[str, Any]:
    effects = [{"id": name, "probability": p, "credible_set": [name, *ties]} for name, p in named]
    return {"verdict": verdict, "effects": effects, "closest_matches": []}


@pytest.mark.parametrize(
    ("causes", "said", "outcome"),
    [
        ([["drag"]], statement("missing_physics", ("drag", 0.9)), "right"),
        ([["drag", "friction"]], statement("missing_physics", ("friction", 0.9)), "right"),
        ([["drag"], ["delay"]], statement("missing_physics", ("delay", 0.9)), "part"),
        ([["drag"]], statement("missing_physics", ("drag", 0.9), ("gain", 0.8)), "surplus"),
        ([["drag"]], statement("missing_physics", ("gain", 0.5), ties=("drag",)), "tied"),
        ([["drag"]], statement("missing_physics", ("gain", 0.99)), "wrong"),
        ([["drag"]], statement("nothing"), "wrong"),
        ([["drag"]], statement("unexplained"), "open"),
        ([["drag"]], statement("inconclusive"), "open"),
        ([], statement("nothing"), "right"),
        ([], statement("parameters_only"), "right"),
        ([], statement("missing_physics", ("gain", 0.99)), "wrong"),
        ([], statement("inconclusive"), "open"),
    ],
)
def test_an_outcome_is_what_the_key_makes_of_the_statement(
    causes: list[list[str]], said: dict[str, Any], outcome: str
) -> None:
    assert verdicts.judged(causes, said)["outcome"] == outcome


def test_the_probability_of_a_wrong_name_is_kept() -> None:
    row = verdicts.judged([["drag"]], statement("missing_physics", ("drag", 1.0), ("gain", 0.97)))
    assert row["sure"] == 0.97
    assert verdicts.summary([row, verdicts.failed("lost")])[-1] == (
        "1 of 2 have a name that is wrong with a probability of 0.95 or more"
    )
