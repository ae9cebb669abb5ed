"""How fast a board is: every setting measured, one chosen, written as `fly` takes it."""
