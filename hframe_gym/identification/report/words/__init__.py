"""A result in words: verdict, remaining error, answers to first questions, what to do next."""
