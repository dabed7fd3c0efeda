"""The parts of `fault_matrix.py`: a scene with its steps, what is done, what goes wrong, the judgement."""
