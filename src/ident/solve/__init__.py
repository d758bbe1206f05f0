"""The numerical kernel: sparse least squares by orthogonal transformations. It knows no robot."""
