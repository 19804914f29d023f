"""What a refined cause predicts of a recording, and what is left in its errors of prediction."""
