import pytest
from extremes import PARTS
from extremes.case import cases


def _tests() -> list:
    return [
        pytest.param(
            case,
            marks=[pytest.mark.slow] * case.slow,
            id=f"{part.__name__.split('.')[-1]}: {case.tried}",
        )
        for part in PARTS
        for case in cases(part)
    ]


@pytest.mark.parametrize("case", _tests())
def test_what_is_promised_holds(case):
    assert case.check()
