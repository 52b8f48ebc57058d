"""Property tests draw the same examples every time."""

from hypothesis import settings

settings.register_profile("circlecal", deadline=None, derandomize=True, max_examples=60)
settings.load_profile("circlecal")
