"""The planted faults still stand where they were planted: who rewrites a line writes its fault anew."""

from tests.mutants import MUTANTS, ROOT, homes_and_nodes, texts_of


def test_every_snippet_and_every_test_of_the_planted_faults_stands_once():
    homes, nodes = homes_and_nodes(MUTANTS, texts_of(ROOT))
    assert len(homes) == len(nodes) == len(MUTANTS)
