"""The linearized problem of a search: columns, their inner products and projections."""
