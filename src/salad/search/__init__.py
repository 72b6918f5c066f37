"""Search: the rows most like a query, whoever holds them."""
