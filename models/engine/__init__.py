"""MuJoCo's own step as a state-space model (extra `robots`): contact, loops, tendons, muscles, floating bases."""
