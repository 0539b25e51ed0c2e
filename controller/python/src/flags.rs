//! Flags of `cargo table` as keywords.

use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyList, PyTuple};
use system_tests::flags::Given;

/// The keywords that were given; None is as good as none.
pub fn given(keywords: Option<&Bound<'_, PyDict>>) -> PyResult<Vec<(String, Given)>> {
    let mut all = Vec::new();
    for (name, value) in keywords.into_iter().flatten() {
        let word = |value: Bound<'_, PyAny>| value.str()?.extract::<String>();
        let value = if value.is_none() {
            continue;
        } else if value.is_instance_of::<PyBool>() {
            Given::Switch(value.extract()?)
        } else if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
            let words = value.try_iter()?.map(|value| word(value?));
            Given::Words(words.collect::<PyResult<_>>()?)
        } else {
            Given::Words(vec![word(value)?])
        };
        all.push((name.extract()?, value));
    }
    Ok(all)
}
