import pytest
from extremes import PARTS
from extremes.case import cases


def _tests():
    for part in PARTS:
        for case in cases(part):
            marks = [pytest.mark.slow] * case.slow
            yield pytest.param(
                case, marks=marks, id=f"{part.__name__.split('.')[-1]}: {case.tried}"
            )


@pytest.mark.parametrize("case", _tests())
def test_what_is_promised_holds(case):
    assert case.check()
