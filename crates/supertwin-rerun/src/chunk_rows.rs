//! The rows of a chunk of a recording: numbers, texts, bytes and properties, with their times.

use crate::{TICK, TIME};
use rerun::ComponentIdentifier;
use rerun::external::arrow::array::{Array, ArrayRef, Float64Array, StringArray, UInt64Array};
use rerun::log::Chunk;
use std::collections::BTreeMap;
use supertwin_core::Property;
use supertwin_core::source::{Columns, Label, WireMessage};

/// Adds all rows of a chunk, or none.
pub(crate) fn add_rows(columns: &mut Columns, chunk: &Chunk, component: ComponentIdentifier) -> Result<(), String> {
    let moments = Moments::new(chunk, component)?;
    let list = chunk.components().get_array(component).ok_or("the values are gone")?;
    let values = list.values().as_any().downcast_ref::<Float64Array>().ok_or("its values are not numbers")?;
    let widths = || moments.rows.iter().map(|&row| (row, list.value_length(row) as usize));
    let Some((_, first)) = widths().next() else { return Ok(()) };
    let width = if columns.tick.is_empty() { first } else { columns.width };
    if let Some((row, other)) = widths().find(|(_, other)| *other != width) {
        return Err(format!("{other} values at tick {}, {width} before", moments.tick[row]));
    }
    for &row in &moments.rows {
        let start = list.value_offsets()[row] as usize;
        columns.values.extend_from_slice(&values.values()[start..start + width]);
    }
    let before = columns.tick.len();
    columns.width = width;
    columns.tick.extend(moments.ticks());
    columns.time_ns.extend(moments.times());
    for (name, clock) in &moments.clocks {
        let column = columns.clocks.entry(name.clone()).or_insert_with(|| vec![None; before]);
        column.resize(before, None);
        column.extend(moments.rows.iter().map(|&row| Some(clock[row])));
    }
    let rows = columns.tick.len();
    columns.clocks.values_mut().for_each(|clock| clock.resize(rows, None));
    Ok(())
}

/// Texts by tick.
pub(crate) fn labels(chunk: &Chunk, component: ComponentIdentifier) -> Result<Vec<Label>, String> {
    let moments = Moments::new(chunk, component)?;
    let texts = strings(chunk, component);
    let rows = moments.ticks().zip(moments.times()).zip(texts);
    Ok(rows.filter_map(|((tick, time_ns), value)| Some(Label { tick, time_ns, value: value? })).collect())
}

/// Exact messages by tick.
pub(crate) fn wired(chunk: &Chunk, component: ComponentIdentifier) -> Result<Vec<WireMessage>, String> {
    let moments = Moments::new(chunk, component)?;
    let bytes = chunk.iter_slices::<&[u8]>(component);
    Ok(moments
        .rows
        .iter()
        .zip(bytes)
        .filter_map(|(&row, bytes)| {
            let clocks = moments.clocks.iter().map(|(name, clock)| (name.clone(), clock[row])).collect();
            let bytes = bytes.first()?.to_vec();
            Some(WireMessage { tick: moments.tick[row], time_ns: moments.time_ns[row], clocks, bytes })
        })
        .collect())
}

/// When the rows of a chunk that have a component were.
struct Moments<'a> {
    /// Those that have it.
    rows: Vec<usize>,
    tick: &'a [i64],
    time_ns: &'a [i64],
    clocks: BTreeMap<String, &'a [i64]>,
}

impl<'a> Moments<'a> {
    fn new(chunk: &'a Chunk, component: ComponentIdentifier) -> Result<Self, String> {
        let on = |timeline: &'static str| chunk.timelines().get(&timeline.into()).map(|times| times.times_raw());
        let (Some(tick), Some(time_ns)) = (on(TICK), on(TIME)) else {
            return Err(format!("not on the timelines {TICK} and {TIME}"));
        };
        let list = chunk.components().get_array(component).ok_or("the values are gone")?;
        let rows = (0..chunk.num_rows()).filter(|&row| list.is_valid(row)).collect();
        let clocks = chunk.timelines().iter().map(|(name, times)| (name.to_string(), times.times_raw()));
        let clocks = clocks.filter(|(name, _)| name != TICK && name != TIME).collect();
        Ok(Self { rows, tick, time_ns, clocks })
    }

    fn ticks(&self) -> impl Iterator<Item = i64> + '_ {
        self.rows.iter().map(|&row| self.tick[row])
    }

    fn times(&self) -> impl Iterator<Item = i64> + '_ {
        self.rows.iter().map(|&row| self.time_ns[row])
    }
}

/// The strings of a component: the first of every row that has any; all of them when there is one row only.
pub(crate) fn strings(chunk: &Chunk, component: ComponentIdentifier) -> impl Iterator<Item = Option<String>> {
    let single = chunk.num_rows() == 1;
    chunk.iter_slices::<String>(component).flat_map(move |texts| {
        let mut texts: Vec<_> = texts.iter().map(|text| Some(text.as_str().to_owned())).collect();
        texts.resize(if single { texts.len() } else { 1 }, None);
        texts
    })
}

/// A property: the only value of its component.
pub(crate) fn property(values: &ArrayRef) -> Option<Property> {
    let any = values.as_any();
    if values.len() != 1 || values.is_null(0) {
        return None;
    }
    if let Some(text) = any.downcast_ref::<StringArray>() {
        return Some(Property::Text(text.value(0).to_owned()));
    }
    if let Some(number) = any.downcast_ref::<Float64Array>() {
        return Some(Property::Number(number.value(0)));
    }
    any.downcast_ref::<UInt64Array>().map(|integer| Property::Integer(integer.value(0)))
}
