"""`vwnav calibrate mount` over rendered flights whose camera hangs as was drawn."""
