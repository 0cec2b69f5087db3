"""A legend names each way to see a particle twice once, however many sides of folds it has."""

from rtpiv.analysis.pictures.results import by_words


def test_sides_of_a_fold_share_one_entry():
    kinds = [((), ("near",)), ((), ("near", "far")), ((), ("near",)), (("near",), ("far",)), ((), ("near",))]
    assert by_words(kinds) == {"direct and near": [0, 2, 4], "direct and near, far": [1], "near and far": [3]}
