"""Actuation: conversion of actions to the voltages at the motors, with converters and delays."""
