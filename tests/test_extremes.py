"""The catalogue of extremes: each case is a test."""

import pytest
from extremes import PARTS
from extremes.case import cases


def _cases() -> list:
    return [
        pytest.param(
            case,
            marks=[pytest.mark.slow] * case.slow,
            id=f"{part.__name__.split('.')[-1]}: {case.tried}",
        )
        for part in PARTS
        for case in cases(part)
    ]


@pytest.mark.parametrize("case", _cases())
def test_promise(case):
    assert case.check()
