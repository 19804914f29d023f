"""Reality in space: trees of hinges that MuJoCo simulates, with the effects of the plane that have a meaning there."""
