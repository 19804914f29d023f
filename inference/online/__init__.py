"""What is known of each row as rows come: a fixed-lag smoother, rows by their times, and a test for change."""
