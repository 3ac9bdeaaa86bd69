"""What every room needs: types and contracts, tasks, the ball, gradient ascent, networks, random numbers, metrics."""
