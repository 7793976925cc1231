//! The wide table in columns: null where a signal has no row.

use super::Exported;
use super::tick_table::{Cursor, State, TickTable, seconds};
use crate::Recording;
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::properties::WriterProperties;
use rerun::external::arrow::array::{ArrayRef, Float64Array, Float64Builder, Int64Array, RecordBatch, StringBuilder};
use rerun::external::arrow::datatypes::{DataType, Field, Schema};
use std::io::{self, Write};
use std::sync::Arc;

/// Rows that are put together at a time.
const BATCH: usize = 1 << 16;

pub(super) fn write(recording: &Recording, table: &TickTable<'_>, to: impl Write + Send) -> io::Result<Exported> {
    let names = table.names();
    let mut fields =
        vec![Field::new("tick", DataType::Int64, false), Field::new("sim_time_s", DataType::Float64, false)];
    fields.extend(names.into_iter().map(|name| Field::new(name, DataType::Float64, true)));
    fields.extend(table.labels.iter().map(|(path, _)| Field::new(*path, DataType::Utf8, true)));
    let columns = fields.len();
    let properties = serde_json::to_string(&recording.properties)?;
    let about = [("supertwin.run".to_owned(), recording.name.clone()), ("supertwin.properties".to_owned(), properties)];
    let schema = Arc::new(Schema::new(fields).with_metadata(about.into()));
    let options = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::default()))
        // Measured values hardly ever repeat.
        .set_dictionary_enabled(false)
        .build();
    let mut file = ArrowWriter::try_new(to, Arc::clone(&schema), Some(options))?;
    let mut signals: Vec<_> = table.signals.iter().map(|(_, columns)| (Cursor::new(columns), columns.width)).collect();
    let mut labels: Vec<_> = table.labels.iter().map(|(_, changes)| State::new(changes)).collect();
    for moments in table.moments.chunks(BATCH) {
        let ticks = moments.iter().map(|moment| moment.0);
        let mut arrays: Vec<ArrayRef> = vec![
            Arc::new(Int64Array::from_iter_values(ticks.clone())),
            Arc::new(Float64Array::from_iter_values(moments.iter().map(|moment| seconds(moment.1)))),
        ];
        for (cursor, width) in &mut signals {
            let mut columns: Vec<_> = (0..*width).map(|_| Float64Builder::with_capacity(moments.len())).collect();
            for tick in ticks.clone() {
                let row = cursor.at(tick);
                for (i, column) in columns.iter_mut().enumerate() {
                    column.append_option(row.map(|row| row[i]));
                }
            }
            arrays.extend(columns.iter_mut().map(|column| Arc::new(column.finish()) as ArrayRef));
        }
        for label in &mut labels {
            let mut column = StringBuilder::new();
            ticks.clone().for_each(|tick| column.append_option(label.at(tick).map(|(value, _)| value)));
            arrays.push(Arc::new(column.finish()));
        }
        file.write(&RecordBatch::try_new(Arc::clone(&schema), arrays).map_err(io::Error::other)?)?;
    }
    file.close()?;
    Ok(Exported { rows: table.moments.len() as u64, columns })
}
