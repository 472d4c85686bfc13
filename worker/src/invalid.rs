//! Invalid values of keys, with remedies; checks of numbers that most keys need.

use std::fmt::Display;

use serde::Serialize;

/// A key whose value makes a trial impossible.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{key}{}{value}: {remedy}", if value.is_empty() { "" } else { " = " })]
pub struct Invalid {
    /// Path of the key in the spec, such as `body.stiffness.stretch`.
    pub key: String,
    /// Its value; empty if missing.
    pub value: String,
    /// What the value must be.
    pub remedy: String,
}

/// An invalid value of a key, with the remedy.
pub fn invalid(key: &str, value: impl Display, remedy: impl Into<String>) -> Invalid {
    Invalid { key: key.into(), value: value.to_string(), remedy: remedy.into() }
}

/// Formats a value as in a spec; `None` as an empty string.
pub fn as_written(value: &impl Serialize) -> String {
    toml::Value::try_from(value).map_or(String::new(), |value| value.to_string())
}

/// Checks a condition on the value of a key.
///
/// # Errors
/// If it does not hold.
pub fn require(holds: bool, key: &str, value: impl Display, remedy: &str) -> Result<(), Invalid> {
    if holds { Ok(()) } else { Err(invalid(key, value, remedy)) }
}

/// Rejects a key that is set.
pub(crate) fn absent(key: &str, given: Option<impl Display>, remedy: &str) -> Result<(), Invalid> {
    given.map_or(Ok(()), |value| Err(invalid(key, value, remedy)))
}

/// Checks that a number is finite and above 0.
///
/// # Errors
/// If it does not hold.
pub fn positive(key: &str, value: f64) -> Result<(), Invalid> {
    require(value > 0.0 && value.is_finite(), key, value, "must be a number above 0")
}

pub(crate) fn not_negative(key: &str, value: f64) -> Result<(), Invalid> {
    require(value >= 0.0 && value.is_finite(), key, value, "must be 0 or a number above")
}

pub(crate) fn at_least(key: &str, value: usize, least: usize) -> Result<(), Invalid> {
    require(value >= least, key, value, &format!("must be at least {least}"))
}

/// Checks both limits.
pub(crate) fn within(key: &str, value: usize, least: usize, most: usize) -> Result<(), Invalid> {
    at_least(key, value, least)?;
    at_most(key, value, most)
}

/// Rejects values for which memory cannot suffice.
pub(crate) fn at_most(key: &str, value: usize, most: usize) -> Result<(), Invalid> {
    require(value <= most, key, value, &format!("must be at most {most}"))
}
