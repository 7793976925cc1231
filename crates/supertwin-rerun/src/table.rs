//! Tables of results as Parquet files: a row per run, columns by name.
//!
//! The same content has the same bytes: nothing in the file depends on when, where or by how many threads it was made.

use crate::atomic_file;
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::arrow::arrow_writer::ArrowWriterOptions;
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use rerun::external::arrow::array::{
    Array, ArrayRef, BooleanArray, Float64Array, RecordBatch, StringArray, UInt64Array,
};
use rerun::external::arrow::compute::concat_batches;
use rerun::external::arrow::datatypes::{DataType, Field, Schema};
use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The writer that files name: it does not change with the library's version, which would change their bytes.
const CREATED_BY: &str = concat!("supertwin version ", env!("CARGO_PKG_VERSION"));

/// The values of a column; `None` is null, which is not the same as NaN.
#[derive(Clone, Debug, PartialEq)]
pub enum Column {
    /// Real numbers; `None` becomes a null.
    Number(Vec<Option<f64>>),
    /// Whole numbers from 0.
    Count(Vec<Option<u64>>),
    /// UTF-8 text; `None` becomes a null.
    Text(Vec<Option<String>>),
    /// True or false.
    Flag(Vec<Option<bool>>),
}

impl Column {
    /// Number of values, nulls counted.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Self::Number(values) => values.len(),
            Self::Count(values) => values.len(),
            Self::Text(values) => values.len(),
            Self::Flag(values) => values.len(),
        }
    }

    /// Whether there are no values at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn data_type(&self) -> DataType {
        match self {
            Self::Number(_) => DataType::Float64,
            Self::Count(_) => DataType::UInt64,
            Self::Text(_) => DataType::Utf8,
            Self::Flag(_) => DataType::Boolean,
        }
    }

    fn array(&self) -> ArrayRef {
        match self {
            Self::Number(values) => Arc::new(Float64Array::from(values.clone())),
            Self::Count(values) => Arc::new(UInt64Array::from(values.clone())),
            Self::Text(values) => Arc::new(StringArray::from_iter(values.iter().map(Option::as_deref))),
            Self::Flag(values) => Arc::new(BooleanArray::from(values.clone())),
        }
    }

    /// `None` when the array is of none of our kinds.
    fn of(array: &dyn Array) -> Option<Self> {
        let any = array.as_any();
        let number = any.downcast_ref::<Float64Array>().map(|array| Self::Number(array.iter().collect()));
        let count = || any.downcast_ref::<UInt64Array>().map(|array| Self::Count(array.iter().collect()));
        let owned = |array: &StringArray| array.iter().map(|value| value.map(str::to_owned)).collect();
        let text = || any.downcast_ref::<StringArray>().map(|array| Self::Text(owned(array)));
        let flag = || any.downcast_ref::<BooleanArray>().map(|array| Self::Flag(array.iter().collect()));
        number.or_else(count).or_else(text).or_else(flag)
    }
}

/// Columns of equal length, each with a name of its own, and what the file says about itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Names and texts in the file's metadata.
    pub about: BTreeMap<String, String>,
    columns: Vec<(String, Column)>,
}

/// A table can't be put together, written or read.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// A column does not fit to the others.
    #[error("column {name}: {rule}")]
    Column {
        /// Name of the column.
        name: String,
        /// The broken rule.
        rule: String,
    },
    /// The file can't be written, or is no table.
    #[error("{}: {cause}", path.display())]
    File {
        /// The table's file.
        path: PathBuf,
        /// What the system or the parser reported.
        cause: String,
    },
}

impl Table {
    /// Appends a column.
    ///
    /// # Errors
    /// When there is a column of this name, or its length is not that of the others.
    pub fn push(&mut self, name: impl Into<String>, column: Column) -> Result<(), TableError> {
        let name = name.into();
        if self.column(&name).is_some() {
            return Err(TableError::Column { name, rule: "is there already".to_owned() });
        }
        if !self.columns.is_empty() && column.len() != self.rows() {
            let rule = format!("has {} values, the others have {}", column.len(), self.rows());
            return Err(TableError::Column { name, rule });
        }
        self.columns.push((name, column));
        Ok(())
    }

    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, |(_, column)| column.len())
    }

    /// All columns with their names, in the order of the file.
    #[must_use]
    pub fn columns(&self) -> &[(String, Column)] {
        &self.columns
    }

    /// The column of this name.
    #[must_use]
    pub fn column(&self, name: &str) -> Option<&Column> {
        self.columns.iter().find(|(known, _)| known == name).map(|(_, column)| column)
    }

    /// Writes the file at `path`, whole or not at all. Without `overwrite` a file that exists stays as it is.
    ///
    /// # Errors
    /// When the file exists or can't be written.
    pub fn write(&self, path: &Path, overwrite: bool) -> Result<(), TableError> {
        let written: io::Result<()> = atomic_file::create(path, overwrite, |file, _| self.put(file));
        written.map_err(|error| TableError::File { path: path.to_owned(), cause: error.to_string() })
    }

    fn put(&self, file: File) -> io::Result<()> {
        let fields: Vec<Field> =
            self.columns.iter().map(|(name, column)| Field::new(name, column.data_type(), true)).collect();
        let schema = Arc::new(Schema::new(fields));
        let about = self.about.iter().map(|(name, text)| KeyValue::new(name.clone(), text.clone())).collect();
        let properties = WriterProperties::builder()
            .set_created_by(CREATED_BY.to_owned())
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .set_key_value_metadata(Some(about))
            .build();
        // Parquet's own types say all there is to say; Arrow's copy of the schema would come in no fixed order.
        let options = ArrowWriterOptions::new().with_properties(properties).with_skip_arrow_metadata(true);
        let mut writer = ArrowWriter::try_new_with_options(file, Arc::clone(&schema), options)?;
        if !self.columns.is_empty() {
            let arrays = self.columns.iter().map(|(_, column)| column.array()).collect();
            writer.write(&RecordBatch::try_new(schema, arrays).map_err(io::Error::other)?)?;
        }
        writer.into_inner()?.sync_all()
    }

    /// Reads a file that [`Self::write`] wrote, or another program that keeps to the four kinds of columns.
    ///
    /// # Errors
    /// When it can't be read, is no Parquet file, or has a column of another kind.
    pub fn read(path: &Path) -> Result<Self, TableError> {
        let wrong = |cause: String| TableError::File { path: path.to_owned(), cause };
        let file = File::open(path).map_err(|error| wrong(error.to_string()))?;
        let builder = ParquetRecordBatchReaderBuilder::try_new(file).map_err(|error| wrong(error.to_string()))?;
        let metadata = builder.metadata().file_metadata().key_value_metadata();
        let about = metadata
            .into_iter()
            .flatten()
            .map(|pair| (pair.key.clone(), pair.value.clone().unwrap_or_default()))
            .filter(|(name, _)| name != parquet::arrow::ARROW_SCHEMA_META_KEY)
            .collect();
        let schema = Arc::clone(builder.schema());
        let reader = builder.build().map_err(|error| wrong(error.to_string()))?;
        let batches: Result<Vec<_>, _> = reader.collect();
        let all = batches.and_then(|batches| concat_batches(&schema, &batches));
        let all = all.map_err(|error| wrong(error.to_string()))?;
        let mut columns = Vec::new();
        for (field, array) in schema.fields().iter().zip(all.columns()) {
            let (name, kind) = (field.name(), field.data_type());
            let column = Column::of(array);
            let none = || wrong(format!("column {name} is of type {kind}: not one of ours"));
            columns.push((name.clone(), column.ok_or_else(none)?));
        }
        Ok(Self { about, columns })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Table {
        let mut table = Table::default();
        for (name, text) in [("supertwin.spec", "a = 1"), ("a", "b"), ("z", ""), ("m", "ü")] {
            table.about.insert(name.to_owned(), text.to_owned());
        }
        let columns = [
            ("run", Column::Count(vec![Some(0), Some(u64::MAX), None])),
            ("score", Column::Number(vec![Some(0.1), None, Some(-0.0)])),
            ("controller", Column::Text(vec![Some("pid".to_owned()), Some(String::new()), None])),
            ("complete", Column::Flag(vec![None, Some(true), Some(false)])),
        ];
        for (name, column) in columns {
            table.push(name, column).expect("fits");
        }
        table
    }

    #[test]
    fn a_table_reads_back_as_it_was_with_the_same_bytes_each_time() {
        let folder = tempfile::tempdir().expect("a folder");
        let [first, second] = ["a.parquet", "b.parquet"].map(|name| folder.path().join(name));
        sample().write(&first, false).expect("is written");
        assert_eq!(Table::read(&first).expect("is read"), sample());
        for _ in 0..8 {
            sample().write(&second, true).expect("is written");
            assert_eq!(std::fs::read(&first).expect("there"), std::fs::read(&second).expect("there"));
        }
    }

    #[test]
    fn nan_is_not_null() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("nan.parquet");
        let mut table = Table::default();
        table.push("x", Column::Number(vec![Some(f64::NAN), None, Some(f64::INFINITY)])).expect("fits");
        table.write(&path, false).expect("is written");
        let Some(Column::Number(read)) = Table::read(&path).expect("is read").column("x").cloned() else {
            panic!("not a column of numbers")
        };
        assert!(read[0].is_some_and(f64::is_nan) && read[1].is_none() && read[2] == Some(f64::INFINITY), "{read:?}");
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let mut table = sample();
        let short = table.push("short", Column::Flag(vec![None])).expect_err("too short").to_string();
        assert_eq!(short, "column short: has 1 values, the others have 3");
        let twice = table.push("run", Column::Flag(vec![None; 3])).expect_err("twice").to_string();
        assert_eq!(twice, "column run: is there already");
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("no.parquet");
        std::fs::write(&path, "nothing of the kind, but long enough").expect("is written");
        let no = Table::read(&path).expect_err("no table").to_string();
        assert!(no.contains("no.parquet") && no.to_lowercase().contains("parquet"), "{no}");
        sample().write(&path, true).expect("is replaced");
        let bytes = std::fs::read(&path).expect("there");
        std::fs::write(&path, &bytes[..bytes.len() / 2]).expect("is cut");
        Table::read(&path).expect_err("half a table");
    }
}
