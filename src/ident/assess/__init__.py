"""Judgement as data: what was found, what is left, whether it will do, and what comes next.

All forms are written from one `Assessment`: a terminal, a page, a notebook, JSON.
"""
