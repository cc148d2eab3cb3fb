"""Scenes and helpers of several test files; no test file imports from another one."""
