"""The paper's own numbers and remarks beside ours."""
