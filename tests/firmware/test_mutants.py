"""The record of mutants that no test can notice is one of changes of the source as it is."""

from __future__ import annotations

from tests.harness.firmware.mutants import FILES, equivalents, mutants


def test_each_equivalent_mutant_is_a_change_of_the_source_and_has_its_reason() -> None:
    changes = {(mutant.file, mutant.changed) for file in FILES for mutant in mutants(file)}

    assert equivalents()
    assert equivalents().keys() <= changes
    assert all(len(reason) > 8 for reason in equivalents().values())
