"""The live simulator: a membrane pressed by an object, seen by two noisy cameras, with ground truth."""
