"""Tables and figures, one module each: `python -m benchmarks NAME --data FOLDER`."""
