"""Joining and applying tensors whose leading dimensions differ."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import mutually_broadcastable_shapes

from invdyn.models.shapes import apply, by_column, common, join, joined_by_column, stacked


@given(mutually_broadcastable_shapes(num_shapes=3, min_dims=0, max_dims=3, max_side=3), st.booleans())
def test_pieces_are_joined_along_the_last_dimension(shapes, alike):
    batches = [shapes.result_shape] * 3 if alike else shapes.input_shapes
    assert common(*batches) == torch.broadcast_shapes(*batches) == shapes.result_shape
    pieces = [torch.randn(*batch, n, dtype=torch.float64) for n, batch in enumerate(batches, 1)]
    joined = join(*pieces)
    assert joined.shape == (*shapes.result_shape, 6)
    for own, piece in zip(joined.split([1, 2, 3], -1), pieces, strict=True):
        torch.testing.assert_close(own, piece.expand_as(own), rtol=0, atol=0)
    columns = [column for piece in pieces for column in piece.unbind(-1)]
    for other in (by_column(joined), joined_by_column(*pieces), stacked(columns)):
        assert torch.equal(other, joined)
        assert all(column.is_contiguous() for column in other.unbind(-1))


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="broadcast"):
        common((2, 3), (4,))


def test_a_matrix_is_applied_to_many_vectors():
    matrix, vector = torch.randn(2, 3, 4), torch.randn(5, 1, 4)
    torch.testing.assert_close(apply(matrix, vector), torch.einsum("bpd,abd->abp", matrix, vector.expand(5, 2, 4)))
