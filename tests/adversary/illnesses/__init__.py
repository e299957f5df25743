"""Makes recordings of sick lines and networks, and measures what `check` names of them.

What is made is written from causes in the field, without the rules that judge.
"""
