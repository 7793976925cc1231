//! The wide table as text: empty where a signal has no row; every number reads back as the same bits.

use super::Exported;
use super::tick_table::{Cursor, State, TickTable, seconds};
use std::io::{self, Write};

pub(super) fn write(table: &TickTable<'_>, to: impl Write) -> io::Result<Exported> {
    let mut file = csv::Writer::from_writer(to);
    let mut header = vec!["tick".to_owned(), "sim_time_s".to_owned()];
    header.extend(table.names());
    header.extend(table.labels.iter().map(|(path, _)| (*path).to_owned()));
    file.write_record(&header)?;
    let mut signals: Vec<_> = table.signals.iter().map(|(_, columns)| (Cursor::new(columns), columns.width)).collect();
    let mut labels: Vec<_> = table.labels.iter().map(|(_, changes)| State::new(changes)).collect();
    for &(tick, time_ns) in &table.moments {
        file.write_field(tick.to_string())?;
        file.write_field(text(seconds(time_ns)))?;
        for (cursor, width) in &mut signals {
            match cursor.at(tick) {
                Some(row) => row.iter().try_for_each(|value| file.write_field(text(*value)))?,
                None => (0..*width).try_for_each(|_| file.write_field(""))?,
            }
        }
        for label in &mut labels {
            file.write_field(label.at(tick).map_or("", |(value, _)| value))?;
        }
        file.write_record(None::<&[u8]>)?;
    }
    file.flush()?;
    Ok(Exported { rows: table.moments.len() as u64, columns: header.len() })
}

/// The shortest text that reads back as the same number.
fn text(number: f64) -> String {
    format!("{number:?}")
}
