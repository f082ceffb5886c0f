"""The closed loop: find the residual, trace it to an effect the model lacks, add it, report both sides."""
