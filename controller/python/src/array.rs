//! Arrays of NumPy: taken with any type that becomes `float64`, given as `float64`.

use numpy::{
    AllowTypeChange, PyArray1, PyArray2, PyArray3, PyArrayLikeDyn, PyArrayMethods,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;

use crate::error;

/// The rows of an array-like of shape (`count`, N); any number of rows where `count` is `None`.
///
/// # Errors
/// `ValueError` names the argument, its shape and what is allowed.
pub fn rows<const N: usize>(
    name: &str,
    value: &Bound<'_, PyAny>,
    count: Option<usize>,
) -> PyResult<Vec<[f64; N]>> {
    let array: PyArrayLikeDyn<'_, f64, AllowTypeChange> = value.extract()?;
    let shape = array.shape();
    let is_fit =
        matches!(*shape, [rows, columns] if columns == N && count.is_none_or(|n| n == rows));
    if !is_fit {
        let rows = count.map_or("any number".to_owned(), |count| count.to_string());
        let message = format!("{name}: shape {shape:?}; allowed: [{rows}, {N}]");
        return Err(error::value(message));
    }
    // In the order of the indices, whatever the strides are.
    let flat: Vec<f64> = array.as_array().iter().copied().collect();
    Ok(flat.as_chunks().0.to_vec())
}

/// An array-like of shape (`count`,).
///
/// # Errors
/// `ValueError` names the argument, its shape and what is allowed.
pub fn list(name: &str, value: &Bound<'_, PyAny>, count: usize) -> PyResult<Vec<f64>> {
    let array: PyArrayLikeDyn<'_, f64, AllowTypeChange> = value.extract()?;
    let shape = array.shape();
    if shape != [count] {
        let message = format!("{name}: shape {shape:?}; allowed: [{count}]");
        return Err(error::value(message));
    }
    Ok(array.as_array().iter().copied().collect())
}

/// An array-like of shape (N,). As [`list`].
///
/// # Errors
/// As [`list`].
pub fn vector<const N: usize>(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[f64; N]> {
    let list = list(name, value, N)?;
    Ok(std::array::from_fn(|k| list[k]))
}

/// An array of shape (`numbers.len()`,).
pub fn of_vector<'py>(py: Python<'py>, numbers: &[f64]) -> Bound<'py, PyArray1<f64>> {
    PyArray1::from_slice(py, numbers)
}

/// An array of shape (`rows.len()`, N).
///
/// # Errors
/// NumPy's.
pub fn of_rows<'py, const N: usize>(
    py: Python<'py>,
    rows: &[[f64; N]],
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    of_vector(py, rows.as_flattened()).reshape([rows.len(), N])
}

/// An array of shape (K, N, 2): N points at each of K places.
///
/// # Errors
/// NumPy's.
pub fn of_path<'py>(
    py: Python<'py>,
    places: &[Vec<[f64; 2]>],
    points: usize,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let flat: Vec<f64> = places.iter().flatten().flatten().copied().collect();
    of_vector(py, &flat).reshape([places.len(), points, 2])
}

/// A camera twist, m/s and rad/s, from an array-like of shape (6,).
///
/// # Errors
/// `ValueError` names the shape or the number that is not finite.
pub fn twist(value: &Bound<'_, PyAny>) -> PyResult<[f64; 6]> {
    let twist = vector("twist", value)?;
    if !twist.iter().all(|x| x.is_finite()) {
        let message = format!("twist = {twist:?}; allowed: six finite numbers");
        return Err(error::value(message));
    }
    Ok(twist)
}
