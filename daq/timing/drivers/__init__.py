"""Drivers of timing units by the name that a bench file gives them; "package.module:Class" works as well."""
